"""TLS certificates that a gateway serves: first and last day, and the mode of the key. Reads files, opens no port."""

from __future__ import annotations

import re
import ssl
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from drivebus.service.config.model import CertificateFiles, PlantConfig

EXPIRY_WARNING = timedelta(days=21)
"""A certificate that ends sooner is announced."""
_PEM_CERTIFICATE = re.compile(r"-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)
_CONTEXT_VERSION, _UTC_TIME, _GENERALIZED_TIME = 0xA0, 0x17, 0x18


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateState:
    """State of the certificate of one gateway."""

    gateway: str
    certificate: Path
    valid_from: datetime
    valid_until: datetime
    key: Path
    key_mode: int

    @property
    def begin_params(self) -> dict[str, str]:
        """Parameters of ``plant.certificate_early``."""
        start = f"{self.valid_from:%Y-%m-%d %H:%M} UTC"
        return {"gateway": self.gateway, "file": str(self.certificate), "start": start}

    def is_early(self, now: datetime) -> bool:
        return now < self.valid_from

    def is_expired(self, now: datetime) -> bool:
        return now > self.valid_until

    def ends_soon(self, now: datetime) -> bool:
        return now > self.valid_until - EXPIRY_WARNING


def certificate_states(config: PlantConfig) -> Iterator[CertificateState]:
    """Yield the certificates of the enabled gateways.

    Files that cannot be read are left out: ``check`` and the gateway itself report them.
    """
    for gateway in config.gateways:
        for files in gateway.certificates if gateway.enabled else ():
            try:
                (start, until), mode = validity(files), files.key.stat().st_mode & 0o777
            except (OSError, ValueError):
                continue
            yield CertificateState(
                gateway=gateway.id,
                certificate=files.certificate,
                valid_from=start,
                valid_until=until,
                key=files.key,
                key_mode=mode,
            )


def validity(files: CertificateFiles) -> tuple[datetime, datetime]:
    """Return begin and end of the first certificate of a PEM file. Raises OSError, ValueError for anything else."""
    match = _PEM_CERTIFICATE.search(files.certificate.read_text(encoding="ascii", errors="replace"))
    if match is None:
        raise ValueError("no certificate")
    return _validity(ssl.PEM_cert_to_DER_cert(match[0]))


def _validity(der: bytes) -> tuple[datetime, datetime]:
    """Return ``notBefore`` and ``notAfter`` of a certificate (RFC 5280, 4.1). Raises ValueError."""
    (_, certificate), *_ = _elements(der)
    (_, to_be_signed), *_ = _elements(certificate)
    fields = [element for element in _elements(to_be_signed) if element[0] != _CONTEXT_VERSION]
    if len(fields) < 4:  # serialNumber, signature, issuer, validity
        raise ValueError("not a certificate")
    start, end = [*_elements(fields[3][1])][:2]
    return _time(*start), _time(*end)


def _time(kind: int, text: bytes) -> datetime:
    """Return a UTCTime or GeneralizedTime. Raises ValueError."""
    digits = text.decode("ascii")
    if kind == _UTC_TIME:
        digits = ("19" if int(digits[:2]) >= 50 else "20") + digits
    elif kind != _GENERALIZED_TIME:
        raise ValueError("not a time")
    return datetime.strptime(digits, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield tag and content of each DER element. Raises ValueError for data that ends too early."""
    at = 0
    while at < len(data):
        tag, length, at = data[at], int.from_bytes(data[at + 1 : at + 2]), at + 2
        if length & 0x80:
            size = length & 0x7F
            length, at = int.from_bytes(data[at : at + size]), at + size
        if at + length > len(data):
            raise ValueError("not a certificate")
        yield tag, data[at : at + length]
        at += length
