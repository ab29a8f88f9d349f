"""``python -m drivebus.web``: the process of the web gateway, started by the service."""

from __future__ import annotations

import asyncio
import json
import sys

from drivebus import i18n
from drivebus.errors import SystemReason
from drivebus.gateways.process import run_gateway
from drivebus.service.auth.service import AuthService
from drivebus.service.ipc.client import SocketClient
from drivebus.service.process.gateway_arguments import GatewayArguments
from drivebus.service.process.tuning import relax_gc
from drivebus.terminal import print_line
from drivebus.web.app import make_app
from drivebus.web.gateway import WebConfig
from drivebus.web.server import HttpServer, listen_host


class WebProcess:
    """Web gateway of this process."""

    def __init__(self) -> None:
        self._server: HttpServer | None = None

    async def serve(self, client: SocketClient, arguments: GatewayArguments[WebConfig], ending: asyncio.Event) -> None:
        """Serve the page and the API until ``ending``.

        Raises ConfigurationError for an unusable address or certificate.
        """
        web, auth = arguments.settings, _auth_service(arguments)
        app = make_app(client, auth, web)
        self._server = HttpServer(app, auth, web, lambda address: _announce(address, auth, arguments), ending)
        relax_gc()
        await self._server.run()

    def reload(self) -> None:
        """Use a renewed certificate."""
        if self._server is not None:
            self._server.reload_certificate()


def _auth_service(arguments: GatewayArguments[WebConfig]) -> AuthService:
    auth = AuthService(arguments.directory, arguments.user_file, had_users=arguments.had_users)
    if not auth.needs_setup and not auth.session_store.exists:  # the sign of a plant that had users
        auth.session_store.write(auth.sessions.stored())
    return auth


def _announce(address: str, auth: AuthService, arguments: GatewayArguments[WebConfig]) -> None:
    """Print the address of the page on standard output, and the remaining manual steps on standard error."""
    # Before the address, whose reader may use the secret at once.
    secret = auth.setup_secret.issue() if auth.needs_setup and not auth.users_missing else None
    if arguments.address_output != "none":
        print_line(json.dumps({"page": address}) if arguments.address_output == "json" else address, sys.stdout)
    if secret is not None:
        file, error = str(auth.setup_secret.path), auth.setup_secret.file_error
        if error is None:
            _print_notice("auth.setup_secret", address=address, secret=secret, file=file)
        else:
            reason = SystemReason(error).text(i18n.preferred())
            _print_notice("auth.setup_secret_unsaved", address=address, secret=secret, file=file, reason=reason)
    if auth.users_missing:
        _print_notice("auth.users_missing", file=str(auth.user_file.path))
    if listen_host(arguments.settings, auth) != arguments.settings.host:
        _print_notice("auth.only_loopback", host=arguments.settings.host)


def _print_notice(key: str, **params: str) -> None:
    print_line(i18n.preferred_text(key, **params), sys.stderr)


if __name__ == "__main__":
    process = WebProcess()
    sys.exit(run_gateway("web", WebConfig, process.serve, process.reload))
