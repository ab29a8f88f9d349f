"""``TlsContext``: TLS settings of the server, renewed while it runs."""

from __future__ import annotations

import contextlib
import logging
import ssl
from pathlib import Path

from drivebus import i18n
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.web.gateway import WebConfig

LOG = logging.getLogger(__name__)


class TlsContext:
    """TLS settings of the server, which follow the certificate's files: connections that are open stay as they are.

    Raises ConfigurationError for a certificate or key that cannot be used.
    """

    def __init__(self, web: WebConfig) -> None:
        self._web = web
        self._files = self._file_state()
        self.context = _tls_context(web)

    def follow_files(self) -> None:
        """Load the files where they have changed."""
        if self._file_state() != self._files:
            self.load()

    def load(self) -> None:
        """Use the files for the next handshakes. A pair that cannot be used is logged, and the old one stays."""
        self._files = self._file_state()
        try:
            _tls_context(self._web)  # the live context would lose its key with a certificate that does not fit
            self.context.load_cert_chain(*self._paths())
        except (ConfigurationError, OSError) as error:
            reason = error if isinstance(error, ConfigurationError) else SystemReason(error)
            LOG.warning(reason.text(i18n.preferred()))
        else:
            LOG.info(i18n.preferred_text("log.certificate_taken_over", file=self._web.certificate))

    def _paths(self) -> tuple[Path, Path | None]:
        assert self._web.certificate is not None
        return self._web.certificate, self._web.key

    def _file_state(self) -> list[tuple[int, ...]]:
        """Return what changes with the content, and with the mode: a key may become readable only afterwards."""
        with contextlib.suppress(OSError):
            states = [path.stat() for path in self._paths() if path is not None]
            return [(state.st_mtime_ns, state.st_ctime_ns, state.st_size, state.st_ino) for state in states]
        return []


def _tls_context(web: WebConfig) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        assert web.certificate is not None
        context.load_cert_chain(web.certificate, web.key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError("auth.certificate", file=str(web.certificate), problem=SystemReason(error)) from error
    return context
