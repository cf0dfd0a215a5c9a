"""Who may connect to the OPC UA server: its own certificate, those that are trusted, and what anonymous clients may do.

<folder>/own/certificate.der, own/key.pem   made at the first start
<folder>/trusted/*.der                      clients that may read, acknowledge and call methods
<folder>/rejected/*.der                     clients that were refused, to be moved to trusted/ by a person
"""

from __future__ import annotations

import asyncio
import datetime
import logging
import socket
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final, NamedTuple

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import cert_gen
from asyncua.crypto.permission_rules import USER_TYPES, SimpleRoleRuleset, User, UserRole
from asyncua.server import monitored_item_service
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from valve_sim.files.whole_files import atomic_write
from valve_sim.model.errors import ValveError

_VALID_DAYS: Final = 3650
_MOST_REJECTED: Final = 100
"""Certificates of refused clients that are kept; a flood of them must not fill the disk."""


class Identity(NamedTuple):
    """The server's own certificate and private key, as files."""

    certificate: Path
    key: Path


def ensure_identity(folder: Path, application_uri: str) -> Identity:
    """The server's certificate and key, made where there are none.

    Args:
        folder: of the server's files. application_uri: what the certificate is issued to.

    Raises:
        ValveError: they cannot be read or written, or the certificate has expired.
    """
    identity = Identity(folder / "own" / "certificate.der", folder / "own" / "key.pem")
    for name in ("trusted", "rejected"):
        try:
            (folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValveError(
                f"{folder / name}: cannot be made ({error.strerror}); choose another folder by the parameter folder"
            ) from error
    if identity.certificate.exists() and identity.key.exists():
        _check(identity)
        return identity
    key = cert_gen.generate_private_key()
    names: list[x509.GeneralName] = [
        x509.UniformResourceIdentifier(application_uri),
        x509.DNSName(socket.gethostname()),
    ]
    certificate = cert_gen.generate_self_signed_app_certificate(
        key, "valve_sim OPC UA server", {}, names, extended=[ExtendedKeyUsageOID.SERVER_AUTH], days=_VALID_DAYS
    )
    with atomic_write(identity.key) as partial:
        partial.touch(mode=0o600)
        partial.write_bytes(cert_gen.dump_private_key_as_pem(key))
    with atomic_write(identity.certificate) as partial:
        partial.write_bytes(certificate.public_bytes(Encoding.DER))
    return identity


def _check(identity: Identity) -> None:
    mend = f"delete {identity.certificate} and {identity.key} to have new ones made, and have clients trust them anew"
    try:
        certificate = x509.load_der_x509_certificate(identity.certificate.read_bytes())
        with identity.key.open("rb"):
            pass
    except OSError as error:
        raise ValveError(f"{error.filename}: cannot be read ({error.strerror}); {mend}") from error
    except ValueError as error:
        raise ValveError(f"{identity.certificate}: is no certificate in DER ({error}); {mend}") from error
    if certificate.not_valid_after_utc < datetime.datetime.now(datetime.timezone.utc):
        raise ValveError(f"{identity.certificate}: expired on {certificate.not_valid_after_utc:%Y-%m-%d}; {mend}")


class Gate:
    """Decides who may connect: a validator of certificates and a manager of users, as asyncua asks for them.

    The folder of trusted certificates is looked at anew for each client, so that a person who moves a certificate there
    need not restart the server.

    Args:
        folder: of the server's files. allows_anonymous: whether clients without a certificate may read.
    """

    def __init__(self, folder: Path, *, allows_anonymous: bool) -> None:
        self._trusted, self._rejected = folder / "trusted", folder / "rejected"
        self._allows_anonymous = allows_anonymous

    async def __call__(self, certificate: Any, description: Any) -> None:
        """Refuse a client whose certificate is out of date, of another application, or not trusted.

        Raises:
            ServiceError: it is refused.
        """
        code = await asyncio.to_thread(self._why_not, certificate, description.ApplicationUri)
        if code is not None:
            raise ServiceError(code)

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> Any:
        """The role of a client; None for one that may not connect."""
        if not certificate:
            return User(UserRole.Anonymous, "anonymous") if self._allows_anonymous else None
        encoded = certificate if isinstance(certificate, bytes) else certificate.public_bytes(Encoding.DER)
        if not self._is_trusted(encoded):
            return None
        loaded = x509.load_der_x509_certificate(encoded)
        names = loaded.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
        return User(UserRole.User, str(names[0].value) if names else loaded.subject.rfc4514_string())

    def _why_not(self, certificate: Any, application_uri: str) -> Any:
        encoded = certificate.public_bytes(Encoding.DER)
        if not self._is_trusted(encoded):
            self._keep(certificate.fingerprint(hashes.SHA256()).hex(), encoded)
            return ua.StatusCodes.BadCertificateUntrusted
        now = datetime.datetime.now(datetime.timezone.utc)
        if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
            return ua.StatusCodes.BadCertificateTimeInvalid
        try:
            named = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except x509.ExtensionNotFound:
            return ua.StatusCodes.BadCertificateInvalid
        if application_uri not in named.get_values_for_type(x509.UniformResourceIdentifier):
            return ua.StatusCodes.BadCertificateUriInvalid
        return None

    def _is_trusted(self, encoded: bytes) -> bool:
        for path in self._trusted.iterdir():
            try:
                content = path.read_bytes()
            except OSError:
                continue
            if content == encoded:
                return True
            if content.startswith(b"-----BEGIN"):
                try:
                    if x509.load_pem_x509_certificate(content).public_bytes(Encoding.DER) == encoded:
                        return True
                except ValueError:
                    continue
        return False

    def _keep(self, fingerprint: str, encoded: bytes) -> None:
        if sum(1 for _ in self._rejected.iterdir()) < _MOST_REJECTED:
            with atomic_write(self._rejected / f"{fingerprint}.der") as partial:
                partial.write_bytes(encoded)


# With a logger for the module, Python does not note the loggers of its subscriptions elsewhere: see `NamedSession`.
_LOGGER_OF_SUBSCRIPTIONS: Final = logging.getLogger(monitored_item_service.__name__)
_CALLER: Final[ContextVar[str]] = ContextVar("caller", default="")
"""Name of the client whose method call is being answered."""


def caller() -> str:
    """The name of the client that calls the method that is running, as its certificate has it."""
    return _CALLER.get()


class NamedSession(InternalSession):
    """A session of a client, of which a method can ask who calls it."""

    async def call(self, params: Any) -> Any:
        """Answer method calls."""
        token = _CALLER.set(getattr(self.user, "name", None) or "")
        try:
            return await super().call(params)
        finally:
            _CALLER.reset(token)

    async def delete_subscriptions(self, ids: Any) -> Any:
        """End subscriptions, and forget the logger that asyncua makes for each: Python keeps loggers for ever."""
        ended = await super().delete_subscriptions(ids)
        for number in ids:
            logging.Logger.manager.loggerDict.pop(f"{_LOGGER_OF_SUBSCRIPTIONS.name}.{number}", None)
        return ended


class NamingServer(InternalServer):
    """asyncua's own server, with sessions that say who calls."""

    def create_session(self, name: str, user: Any = None, external: bool = False) -> Any:
        """A session of a client."""
        return NamedSession(
            self, self.aspace, self.subscription_service, name, user=user or User(UserRole.Anonymous), external=external
        )


class Rules(SimpleRoleRuleset):
    """What each role may ask for.

    Clients with a trusted certificate may ask for all but changes of the address space, anonymous ones for all that
    changes nothing.
    """

    def __init__(self) -> None:
        super().__init__()
        changing = {
            ua.NodeId(ua.ObjectIds.WriteRequest_Encoding_DefaultBinary),
            ua.NodeId(ua.ObjectIds.CallRequest_Encoding_DefaultBinary),
        }
        self._permission_dict[UserRole.Anonymous] = {ua.NodeId(found) for found in USER_TYPES} - changing
