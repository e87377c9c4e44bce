"""`hil panel` beyond loopback: TLS, and a token from every browser, on a real socket."""

import datetime
import http.client
import ipaddress
import ssl
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from support import panel
from support.backlash_axis import lay_out

pytestmark = pytest.mark.outside
TOKEN = "what every browser is asked for"
ADDRESS = "127.0.0.2"  # not one of loopback's names, and still this machine


def certificate(directory: Path) -> tuple[Path, Path]:
    """A self-signed one for ADDRESS, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, ADDRESS)])
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address(ADDRESS))]), critical=False)
        .sign(key, hashes.SHA256())
    )
    paths = directory / "server.crt", directory / "server.key"
    paths[0].write_bytes(made.public_bytes(serialization.Encoding.PEM))
    plain = serialization.NoEncryption()
    form = serialization.PrivateFormat.PKCS8
    paths[1].write_bytes(key.private_bytes(serialization.Encoding.PEM, form, plain))
    return paths


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, ssl.SSLContext]]:
    directory = tmp_path_factory.mktemp("tls")
    cert, key = certificate(directory)
    token = directory / "token"
    token.write_text(f"{TOKEN}\n")
    token.chmod(0o600)
    how = ["--bind", ADDRESS, "--cert", cert, "--key", key, "--token-file", token]
    with panel.served(lay_out(directory), *how) as (address, _):
        yield address, ssl.create_default_context(cafile=str(cert))


def asks(
    server: tuple[str, ssl.SSLContext], method: str, path: str, body: str = "", **headers: str
) -> http.client.HTTPResponse:
    place = urlsplit(server[0])
    link = http.client.HTTPSConnection(place.hostname or "", place.port, context=server[1], timeout=panel.PATIENCE_S)
    try:
        link.request(method, path, body.encode(), {name.replace("_", "-"): text for name, text in headers.items()})
        answer = link.getresponse()
        answer.read()
        return answer
    finally:
        link.close()


def test_nothing_without_the_token(server: tuple[str, ssl.SSLContext]) -> None:
    assert server[0].startswith(f"https://{ADDRESS}:")
    origin = server[0].rstrip("/")
    assert asks(server, "GET", "/axis/X/overview").status == 401
    assert asks(server, "POST", "/stop", Origin=origin).status == 401
    assert asks(server, "POST", "/access", "token=guessed", Origin=origin).status == 401
    admitted = asks(server, "POST", "/access", f"token={TOKEN}", Origin=origin)
    assert admitted.status == 303
    cookie = (admitted.getheader("set-cookie") or "").partition(";")[0]
    assert asks(server, "GET", "/axis/X/overview", Cookie=cookie).status == 200
    assert asks(server, "POST", "/stop", Cookie=cookie, Origin=origin).status == 200
    assert asks(server, "POST", "/stop", Cookie=cookie, Origin="https://evil.example").status == 403
    assert asks(server, "GET", "/axis/X/overview", Cookie=cookie, Host="evil.example").status == 421


def test_nothing_without_tls(server: tuple[str, ssl.SSLContext]) -> None:
    place = urlsplit(server[0])
    plain = http.client.HTTPConnection(place.hostname or "", place.port, timeout=panel.PATIENCE_S)
    try:
        plain.request("GET", "/")
        with pytest.raises((http.client.HTTPException, OSError)):
            plain.getresponse()
    finally:
        plain.close()
