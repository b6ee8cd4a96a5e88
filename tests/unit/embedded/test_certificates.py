"""Certificates of ours, before the eyes of the strictest client."""

import ssl
from pathlib import Path

import pytest

from gaitway.service.embedded.certificates import Certificate, authority, signed


def greeted(client: ssl.SSLContext, server: ssl.SSLContext, host: str) -> None:
    """Go through a whole handshake in memory. Raises ssl.SSLError."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    sides = [
        client.wrap_bio(to_client, to_server, server_hostname=host),
        server.wrap_bio(to_server, to_client, server_side=True),
    ]
    while sides:
        for side in list(sides):
            try:
                side.do_handshake()
                sides.remove(side)
            except ssl.SSLWantReadError:
                pass  # The other side's turn.


@pytest.fixture(scope="module")
def by() -> Certificate:
    return authority("gaitway")


@pytest.fixture
def server(by: Certificate, tmp_path: Path) -> ssl.SSLContext:
    made = signed(by, ["192.0.2.7", "[2001:db8::7]", "stores.example"])
    (tmp_path / "both.pem").write_text(made.certificate + made.key)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(tmp_path / "both.pem")
    return context


@pytest.fixture
def client(by: Certificate) -> ssl.SSLContext:
    """As Python 3.13 makes it by default."""
    context = ssl.create_default_context(cadata=by.certificate)
    context.verify_flags |= ssl.VERIFY_X509_STRICT | ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


@pytest.mark.parametrize("host", ["192.0.2.7", "2001:db8::7", "stores.example"])
def test_a_certificate_holds_for_each_of_its_names(
    host: str, client: ssl.SSLContext, server: ssl.SSLContext
) -> None:
    greeted(client, server, host)


@pytest.mark.parametrize("host", ["192.0.2.8", "other.example"])
def test_it_holds_for_no_other(host: str, client: ssl.SSLContext, server: ssl.SSLContext) -> None:
    with pytest.raises(ssl.SSLCertVerificationError, match="mismatch"):
        greeted(client, server, host)


def test_what_it_signed_signs_nothing_itself(by: Certificate, tmp_path: Path, client: ssl.SSLContext) -> None:
    between = signed(by, ["192.0.2.7"])
    made = signed(between, ["192.0.2.7"])
    (tmp_path / "chain.pem").write_text(made.certificate + between.certificate + made.key)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(tmp_path / "chain.pem")
    with pytest.raises(ssl.SSLCertVerificationError, match="CA"):
        greeted(client, context, "192.0.2.7")
