"""Certificates for servers of tests."""

import subprocess
from pathlib import Path


def self_signed(folder: Path) -> Path:
    """A certificate of "localhost", signed by itself, in a folder; its key is beside it in key.pem."""
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem"), "-days", "2"]
    command += ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "cert.pem"
