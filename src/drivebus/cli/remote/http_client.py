"""HTTP client of a service, from the standard library: follows no redirects, checks certificates.

Each request has its own connection: a stop never waits for another request, and no request is lost on a connection that
the service has closed meanwhile.
"""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import ssl
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlencode, urlsplit

from drivebus.cli.remote.unknown_outcome import outcome_unknown_on_loss
from drivebus.control_characters import without_control_characters
from drivebus.errors import ConfigurationError, ServiceUnavailable, SystemReason
from drivebus.service.config.loopback import is_loopback
from drivebus.types import Json

if TYPE_CHECKING:
    from drivebus.service.api.operations import Operation

CONNECT_TIMEOUT_S = 5.0
RESPONSE_TIMEOUT_S = 60.0  # a stop is repeated until the drive reports it; a group starts one drive after another
MAX_RESPONSE_BYTES = 64 * 1024 * 1024
NO_TLS_REASONS = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE")  # of OpenSSL for a server that answers in plain HTTP


class HttpClient:
    """Calls operations over HTTP, each request in a thread."""

    is_local = False

    def __init__(self, address: str, token: str | None) -> None:
        """Raise ConfigurationError for an invalid address, and for a token that would cross a network unencrypted."""
        try:
            parts = urlsplit(address)
            port, host = parts.port, parts.hostname
        except ValueError as error:
            raise ConfigurationError("service.address", found=address) from error
        if parts.scheme not in ("http", "https") or not host or parts.username or parts.query or parts.fragment:
            raise ConfigurationError("service.address", found=address)
        if token is None:
            raise ConfigurationError("service.no_token", address=address)
        if not re.fullmatch(r"[!-~]{1,500}", token):
            raise ConfigurationError("service.token")
        if parts.scheme == "http" and not is_loopback(host):
            raise ConfigurationError("service.not_secret", address=address)
        self._address, self._token, self._base = address, token, parts.path.rstrip("/")
        self._scheme, self._host, self._port = parts.scheme, host, port

    async def call(self, operation: str, params: Json) -> Json:
        """See ``RemoteClient.call``."""
        with outcome_unknown_on_loss(operation):
            return await asyncio.to_thread(self._call_sync, operation, params)

    async def close(self) -> None:
        """Do nothing: no connection stays open between two requests."""

    def _call_sync(self, operation: str, params: Json) -> Json:
        from drivebus.service.api.operations import OPERATIONS

        method, path, body = http_request(OPERATIONS[operation], params)
        headers = {"Authorization": f"Bearer {self._token}", "Accept": "application/json"}
        headers |= {} if body is None else {"Content-Type": "application/json"}
        connection = self._connect()
        try:
            connection.request(method, self._base + path, body, headers)
            response = connection.getresponse()
            status, text = response.status, response.read(MAX_RESPONSE_BYTES)
        except (OSError, http.client.HTTPException) as error:
            raise ServiceUnavailable("service.silent", address=self._address, reason=SystemReason(error)) from error
        finally:
            connection.close()
        return _parse_response(status, text, self._address)

    def _connect(self) -> http.client.HTTPConnection:
        connection = http.client.HTTPConnection(self._host, self._port, timeout=CONNECT_TIMEOUT_S)
        if self._scheme == "https":
            context = ssl.create_default_context()
            connection = http.client.HTTPSConnection(self._host, self._port, timeout=CONNECT_TIMEOUT_S, context=context)
        try:
            connection.connect()
        except OSError as error:
            if isinstance(error, ssl.SSLError) and error.reason in NO_TLS_REASONS:
                key = "service.no_tls_local" if is_loopback(self._host) else "service.no_tls"
                without_tls = "http" + self._address[len("https") :]
                raise ServiceUnavailable(key, address=self._address, http=without_tls) from error
            raise ServiceUnavailable("service.not_there", address=self._address, reason=SystemReason(error)) from error
        connection.sock.settimeout(RESPONSE_TIMEOUT_S)
        return connection


def http_request(operation: Operation, params: Json) -> tuple[str, str, bytes | None]:
    """Return method, path and body of an operation, from its declaration."""
    rest = {name: value for name, value in params.items() if name not in operation.path_params and value is not None}
    path = operation.url_path.format(**{name: quote(str(params[name]), safe="") for name in operation.path_params})
    if operation.has_body:
        return operation.method, path, json.dumps(rest, allow_nan=False).encode()
    return operation.method, path + (f"?{urlencode(rest, doseq=True)}" if rest else ""), None


def printable_values(value: Any) -> Any:
    """Return a value of a response without control characters but line breaks: a terminal executes the others."""
    if isinstance(value, str):
        return without_control_characters(value, keep="\n\t")
    if isinstance(value, dict):
        return {printable_values(name): printable_values(inner) for name, inner in value.items()}
    return [printable_values(inner) for inner in value] if isinstance(value, list) else value


def _parse_response(status: int, text: bytes, address: str) -> Json:
    """Return the result. Raises the error of the service; ServiceUnavailable for a response of another program."""
    from drivebus.cli.remote.convert import parse_error_outcome
    from drivebus.service.api.errors import error_from_json

    try:
        document = printable_values(json.loads(text))
        if status == 200 and isinstance(document, dict):
            return document
        error = parse_error_outcome(error_from_json(document["error"]))
    except (ValueError, KeyError, TypeError) as problem:
        raise ServiceUnavailable("service.strange", address=address, status=status) from problem
    raise error
