"""Who may connect to the OPC UA server: its own certificate, those that are trusted, and what anonymous clients may do.

<folder>/own/certificate.der, own/key.pem   made at the first start
<folder>/trusted/*.der, *.pem               of clients, or of authorities that issue theirs
"""

from __future__ import annotations

import datetime
import logging
import socket
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import cert_gen
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.crypto.truststore import TrustStore
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from valve_sim.files.whole_files import atomic_write
from valve_sim.model.errors import ValveError

_VALID_DAYS: Final = 3650
_SUFFIXES: Final = (".der", ".pem")
_CHECKS: Final = (
    CertificateValidatorOptions.TIME_RANGE
    | CertificateValidatorOptions.URI
    | CertificateValidatorOptions.TRUSTED
    | CertificateValidatorOptions.PEER_CLIENT
)
_LOGGER: Final = logging.getLogger(__name__)
# The trust store logs a traceback for each stranger; `Gate.validate` logs one line.
logging.getLogger("asyncuagds.validate").setLevel(logging.CRITICAL)


def ensure_identity(folder: Path, application_uri: str) -> tuple[Path, Path]:
    """The files of the server's certificate and private key, made where there are none.

    Args:
        folder: of the server's files. application_uri: what the certificate is issued to.

    Raises:
        ValveError: they cannot be read or written, or the certificate has expired.
    """
    path, key_path = folder / "own" / "certificate.der", folder / "own" / "key.pem"
    if path.exists() and key_path.exists():
        _check(path, key_path)
        return path, key_path
    key = cert_gen.generate_private_key()
    names: list[x509.GeneralName] = [
        x509.UniformResourceIdentifier(application_uri),
        x509.DNSName(socket.gethostname()),
    ]
    certificate = cert_gen.generate_self_signed_app_certificate(
        key, "valve_sim OPC UA server", {}, names, extended=[ExtendedKeyUsageOID.SERVER_AUTH], days=_VALID_DAYS
    )
    with atomic_write(key_path) as partial:
        partial.touch(mode=0o600)
        partial.write_bytes(cert_gen.dump_private_key_as_pem(key))
    with atomic_write(path) as partial:
        partial.write_bytes(certificate.public_bytes(Encoding.DER))
    return path, key_path


def _check(path: Path, key_path: Path) -> None:
    mend = f"delete {path} and {key_path}, start the node again, and have clients trust the new certificate"
    try:
        certificate = x509.load_der_x509_certificate(path.read_bytes())
        key_path.read_bytes()
    except OSError as error:
        raise ValveError(f"{error.filename}: cannot be read ({error.strerror}); {mend}") from error
    except ValueError as error:
        raise ValveError(f"{path}: is no certificate in DER ({error}); {mend}") from error
    if certificate.not_valid_after_utc < datetime.datetime.now(datetime.timezone.utc):
        raise ValveError(f"{path}: expired on {certificate.not_valid_after_utc:%Y-%m-%d}; {mend}")


class Gate(UserManager):
    """Decides who may connect: asyncua's trust store and validator, and the role of a client.

    Args:
        folder: of the server's files. allows_anonymous: whether clients without a certificate may read.
    """

    def __init__(self, folder: Path, *, allows_anonymous: bool) -> None:
        self._folder, self._allows_anonymous = folder / "trusted", allows_anonymous
        self._store, self._changed_at = TrustStore([self._folder], []), 0

    async def load(self) -> None:
        """Read the folder of trusted certificates; those of before stay where it cannot be read.

        Raises:
            ValveError: it cannot be read, or a file in it is no certificate.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._changed_at = self._folder.stat().st_mtime_ns
            store = TrustStore([self._folder], [])
            if any(path.suffix.lower() in _SUFFIXES for path in self._folder.iterdir()):  # it refuses to hold none
                await store.load()
            self._store = store
        except (OSError, ValueError) as error:
            raise ValveError(
                f"{self._folder}: cannot be used ({' '.join(str(error).split())}); it may hold certificates only, "
                "NAME.der or NAME.pem"
            ) from error

    async def validate(self, certificate: x509.Certificate, description: ua.ApplicationDescription) -> None:
        """Refuse a client whose certificate is out of date, of another application, or not trusted.

        Raises:
            ServiceError: it is refused.
        """
        try:
            await self.load()
        except ValveError as error:
            _LOGGER.warning("%s; the certificates of before count", error)
        try:
            await CertificateValidator(_CHECKS, self._store).validate(certificate, description)
        except ServiceError as error:
            _LOGGER.warning(
                "a client is refused: %s, SHA-256 %s: %s; to let it in, put its certificate into %s",
                _name_of(certificate), certificate.fingerprint(hashes.SHA256()).hex(":"),
                ua.StatusCode(error.code).name, self._folder,
            )  # fmt: skip
            raise

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> User | None:
        """The role of a client; None refuses it.

        The certificate is that of the encrypted channel. A client can leave it out of its request for a session, and
        `validate` is then not called: such a client is refused once the folder has changed.
        """
        if not certificate:
            return User(UserRole.Anonymous, "anonymous") if self._allows_anonymous else None
        encoded = certificate if isinstance(certificate, bytes) else certificate.public_bytes(Encoding.DER)
        loaded = x509.load_der_x509_certificate(encoded)
        is_trusted = self._store.validate(loaded) and self._folder.stat().st_mtime_ns == self._changed_at
        return User(UserRole.User, _name_of(loaded)) if is_trusted else None


def _name_of(certificate: x509.Certificate) -> str:
    names = certificate.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
    return str(names[0].value) if names else certificate.subject.rfc4514_string()


class Rules(SimpleRoleRuleset):
    """asyncua's rules, by which clients with a trusted certificate may not change the address space.

    Anonymous clients may ask for what changes nothing.
    """

    _CHANGING = frozenset(
        ua.NodeId(kind)
        for kind in (ua.ObjectIds.WriteRequest_Encoding_DefaultBinary, ua.ObjectIds.CallRequest_Encoding_DefaultBinary)
    )

    def check_validity(self, user: Any, action_type_id: Any, body: Any) -> bool:
        """Whether a user may ask for something."""
        if user.role is UserRole.Anonymous:
            user = User(UserRole.User)
            if action_type_id in self._CHANGING:
                return False
        return bool(super().check_validity(user, action_type_id, body))


_CALLER: Final[ContextVar[str]] = ContextVar("caller", default="")


def caller() -> str:
    """The name of the client that calls the method that is running, as its certificate has it."""
    return _CALLER.get()


class _NamedSession(InternalSession):
    async def call(self, params: Any) -> Any:
        """Answer method calls; asyncua does not tell a method who calls."""
        token = _CALLER.set(getattr(self.user, "name", None) or "")
        try:
            return await super().call(params)
        finally:
            _CALLER.reset(token)


class NamingServer(InternalServer):
    """asyncua's own server, with sessions that say who calls."""

    def create_session(self, name: str, user: Any = None, external: bool = False) -> Any:
        """A session of a client."""
        return _NamedSession(
            self, self.aspace, self.subscription_service, name, user=user or User(UserRole.Anonymous), external=external
        )
