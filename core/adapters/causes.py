"""The causes behind a client library's error."""

import ssl
from collections.abc import Iterator

# OpenSSL's old and new names for an answer that is not TLS.
_NO_TLS_THERE = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "HTTP_REQUEST")


def causes(error: BaseException) -> Iterator[BaseException]:
    """The error, its cause, the cause of that, and so on."""
    found: BaseException | None = error
    while found is not None:
        yield found
        found = found.__cause__ or found.__context__


def reason(error: BaseException) -> str:
    """The operating system's message, or that of the innermost error."""
    innermost = list(causes(error))[-1]
    words = innermost.strerror if isinstance(innermost, OSError) else None
    return (words or str(innermost) or type(innermost).__name__).rstrip(".")


def tls_refusal(error: BaseException, server: str, address: str, without: str) -> str | None:
    """A sentence if the two sides can never agree on TLS; None if a retry may help.

    server: the kind of server. address: the setting that names it. without: how to do without TLS.
    """
    failure = next((found for found in causes(error) if isinstance(found, ssl.SSLError)), None)
    if isinstance(failure, ssl.SSLCertVerificationError):
        return (
            f"The certificate of {server} is not trusted: {failure.verify_message.rstrip('.')}. Let "
            "GAITWAY_TLS_CA name a file with the certificate of the authority that signed it; and "
            f"{address} has to name the host as the certificate does."
        )
    if failure is not None and failure.reason in _NO_TLS_THERE:
        return f"The server at {address} does not speak TLS: {without}, if {server} there has none."
    return None
