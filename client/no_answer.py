"""Says in a line why a service did not answer, and what to do."""

from urllib.parse import urlsplit

import httpx

START = "start one with scene-attack serve, or name it with --url"


def why(error: httpx.HTTPError) -> str:
    """What went wrong between this machine and a service, and the remedy."""
    reason = (str(error) or type(error).__name__).strip()
    try:
        origin = f"{error.request.url.scheme}://{error.request.url.netloc.decode('ascii')}"
    except RuntimeError:  # an error of the client's own has no request
        origin = ""
    other = origin.replace("https://", "http://") if origin.startswith("https") else f"https{origin[4:]}"
    if "WRONG_VERSION_NUMBER" in reason or "record layer failure" in reason:
        return f"{origin} does not speak https; try --url {other}"
    if "CERTIFICATE_VERIFY_FAILED" in reason:
        return f"the certificate of {origin} is not trusted ({reason}); SSL_CERT_FILE names one that is"
    if "Name or service not known" in reason or "No address associated" in reason or "name resolution" in reason:
        return f"there is no host {urlsplit(origin).hostname!r}; name the service with --url"
    if isinstance(error, httpx.DecodingError):
        return f"{reason}; is --url the address of a service?"
    if isinstance(error, httpx.RemoteProtocolError) and origin.startswith("http:"):
        return f"no answer from {origin} ({reason}); if it speaks https, try --url {other}"
    return f"no answer from {origin or 'the service'} ({reason}); {START}"
