"""What tests of the OPC UA server share: the server as a process, certificates, a client that notes what comes."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("asyncua", reason="asyncua is not installed: pip install '.[opcua]'")

from asyncua import Client, ua
from asyncua.crypto import cert_gen
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from valve_sim.station.opcua_server import NAMESPACE

CLIENT_URI = "urn:valve_sim:test:client"


class Served:
    """A server in a process, and what is needed to speak to it."""

    def __init__(self, folder: Path, port: int, *flags: str) -> None:
        self.folder, self.port = folder, port
        command = [sys.executable, str(Path(__file__).with_name("served.py")), str(folder), str(port), *flags]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._line() == "ready"

    @property
    def endpoint(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.port}/valve_sim/"

    def put(self, valve: str, time: float, **values: object) -> None:
        """Tell the server, and wait until it has shown it; `Health__Level` is Health.Level."""
        named = {path.replace("__", "."): value for path, value in values.items()}
        self.begin(valve, time, named)
        assert self._line() == "done"

    def begin(self, valve: str, time: float, values: dict[str, object]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"valve": valve, "time": time, "values": values}) + "\n")
        self.process.stdin.flush()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            stream.close()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


class Identity:
    """A client's certificate and key, as files."""

    def __init__(self, folder: Path, *, is_expired: bool = False) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.certificate, self.key = folder / "client.der", folder / "key.pem"
        key = cert_gen.generate_private_key()
        names: list[Any] = [x509.UniformResourceIdentifier(CLIENT_URI), x509.DNSName("localhost")]
        made = cert_gen.generate_self_signed_app_certificate(
            key, "operator of the test", {}, names, extended=[ExtendedKeyUsageOID.CLIENT_AUTH], days=30
        )
        if is_expired:
            made = x509.CertificateBuilder(
                made.issuer, made.subject, made.public_key(), made.serial_number,
                made.not_valid_before_utc - timedelta(days=365), made.not_valid_after_utc - timedelta(days=365),
                list(made.extensions),
            ).sign(key, hashes.SHA256())  # fmt: skip
        self.key.write_bytes(cert_gen.dump_private_key_as_pem(key))
        self.certificate.write_bytes(made.public_bytes(Encoding.DER))

    def trusted_by(self, folder: Path, name: str = "operator") -> Identity:
        """Put the certificate where a person would."""
        trusted = folder / "trusted"
        trusted.mkdir(parents=True, exist_ok=True)
        (trusted / f"{name}.der").write_bytes(self.certificate.read_bytes())
        return self


async def connected(endpoint: str, identity: Identity | None = None, uri: str = CLIENT_URI) -> Client:
    client = Client(endpoint)
    client.application_uri = uri
    if identity is not None:
        await client.set_security_string(f"Basic256Sha256,SignAndEncrypt,{identity.certificate},{identity.key}")
    await client.connect()
    return client


class Noted:
    """What a subscription brought."""

    def __init__(self) -> None:
        self.values: list[tuple[Any, Any]] = []
        self.events: list[Any] = []
        self._came = asyncio.Event()

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        self.values.append((value, data.monitored_item.Value.SourceTimestamp))
        self._came.set()

    def event_notification(self, event: Any) -> None:
        self.events.append(event)
        self._came.set()

    async def until(self, condition: Any) -> None:
        """Wait for as long as it takes until something holds."""
        while not condition(self):
            self._came.clear()
            await asyncio.wait_for(self._came.wait(), 30.0)


async def place(client: Client, path: str) -> Any:
    """A node of the first valve, "" for the valve itself."""
    index = await client.get_namespace_index(NAMESPACE)
    return client.get_node(ua.NodeId(f"tank_1/valve.{path}" if path else "tank_1/valve", index))
