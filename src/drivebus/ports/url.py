"""Port URLs: the text that names a port, parsed into a ``PortUrl``. Opens nothing.

/dev/ttyUSB0 · COM3 · serial:///dev/ttyUSB0?baud=9600&format=8E1 · tcp://host:port · rfc2217://host:port?baud=9600
sim://c320@0-3,7 · memory://name · replay://FILE.dbcap
"""

from __future__ import annotations

import re
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

from drivebus.errors import PortUrlError
from drivebus.serial_settings import SerialSettings
from drivebus.types import EchoSetting
from drivebus.user_input import half_width, parse_boolean, parse_decimal

DEFAULT_SETTINGS = SerialSettings(9600)  # the factory setting of most models
NETWORK_SCHEMES = frozenset({"tcp", "rfc2217"})
PORT_URL_EXAMPLES = (
    "/dev/ttyUSB0",
    "COM3",
    "serial:///dev/ttyUSB0?baud=9600&format=8E1",
    "tcp://192.168.1.50:4001",
    "sim://c320@1",
)

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_SCHEME_WITHOUT_SLASHES = re.compile(r"(sim|tcp|rfc2217|replay):/?([^/].*)", re.IGNORECASE)
_SIMULATED = re.compile(r"\w+@[0-9][0-9,-]*")
_COM = re.compile(r"(?:\\\\\.\\)?COM[0-9]{1,3}", re.IGNORECASE)
_BAUD = re.compile(r"[0-9]{1,7}")
_HOST_AND_PORT = re.compile(r"[\w.-]+:\d{1,5}")
_NAME_IN_DEV = re.compile(r"tty|serial/by-|rfcomm|cu\.")


@dataclass(frozen=True, slots=True, kw_only=True)
class PortUrl:
    """A parsed port URL.

    ``path`` is everything between ``://`` and ``?`` (a device, a file, ``c320@0-3,7``); ``host`` is its part before
    the first slash, for network schemes without the port number, which is ``port``.
    """

    text: str
    scheme: str
    host: str = ""
    port: int | None = None
    path: str = ""
    settings: SerialSettings = SerialSettings()
    options: Mapping[str, str] = field(default_factory=dict)
    explicit: frozenset[str] = frozenset()
    """Which of "baud" and "format" were specified; the others are defaults."""

    def reject_unknown_options(self, *known: str) -> None:
        """Raise PortUrlError for an option that this scheme does not have."""
        for name in self.options:
            if name not in known:
                expected = tuple(sorted({"baud", "format", *known}))
                raise PortUrlError(
                    "ports.option_unknown", port=self.text, scheme=self.scheme, found=name, expected=expected
                )

    def choice(self, name: str, allowed: Iterable[str], default: str) -> str:
        """Return an option that is one of ``allowed``. Raises PortUrlError."""
        allowed = tuple(allowed)
        text = self.options.get(name, default).lower()
        if text not in allowed:
            raise PortUrlError("ports.option", port=self.text, name=name, found=text, expected=allowed)
        return text

    def echo(self) -> EchoSetting:
        """Return the option ``echo``. Raises PortUrlError."""
        mode = self.choice("echo", ("detect", "on", "off"), "detect")
        return "on" if mode == "on" else "off" if mode == "off" else "detect"

    def flag(self, name: str) -> bool:
        """Return an option that is on or off, off where it is not given. Raises PortUrlError."""
        text = self.options.get(name, "off")
        value = parse_boolean(text)
        if value is None:
            raise PortUrlError("ports.option", port=self.text, name=name, found=text, expected=("on", "off"))
        return value

    def number(self, name: str, default: float, lowest: float, highest: float) -> float:
        """Return an option that is a number within limits. Raises PortUrlError."""
        text = self.options.get(name)
        if text is None:
            return default
        value = _float(text)
        if value is None or not lowest <= value <= highest:
            raise PortUrlError(
                "ports.option", port=self.text, name=name, found=text, expected=f"{lowest:g} … {highest:g}"
            )
        return value


def parse_port_url(
    text: str,
    *,
    baud: int | None = None,
    format: str | None = None,
    defaults: SerialSettings = DEFAULT_SETTINGS,
    **options: Any,
) -> PortUrl:
    """Parse a port URL; arguments override its query, which overrides ``defaults``.

    Raises PortUrlError.
    """
    scheme, rest = _split_scheme(text.strip())
    target, _, query = rest.partition("?")
    chosen = _query(text, query) | {name: _option_text(value) for name, value in options.items() if value is not None}
    if baud is not None:
        chosen["baud"] = str(baud)
    if format is not None:
        chosen["format"] = format
    explicit = frozenset(chosen) & {"baud", "format"}
    settings = _settings(text, chosen.pop("baud", str(defaults.baud)), chosen.pop("format", defaults.format))
    if scheme in NETWORK_SCHEMES:
        host, port = _address(text, scheme, target)
        return PortUrl(
            text=text,
            scheme=scheme,
            host=host,
            port=port,
            settings=settings,
            options=chosen,
            explicit=explicit,
        )
    path = unquote(target)
    if not path and scheme != "sim":  # that port names the simulated drives
        raise PortUrlError("ports.url_empty", port=text, scheme=scheme, examples=PORT_URL_EXAMPLES)
    return PortUrl(
        text=text,
        scheme=scheme,
        host=path.partition("/")[0],
        path=path,
        settings=settings,
        options=chosen,
        explicit=explicit,
    )


def _split_scheme(text: str) -> tuple[str, str]:
    if match := _SCHEME.match(text):
        return match[1].lower(), text[match.end() :]
    path = text.partition("?")[0]
    if path.lower().endswith(".toml"):
        raise PortUrlError("ports.url_plant", found=text)
    if _COM.fullmatch(path) or _is_path(path) or _is_device(path):
        return "serial", text
    raise PortUrlError("ports.url", found=text or '""', examples=PORT_URL_EXAMPLES, hint=_suggestion(text))


def _is_path(path: str) -> bool:
    """Return whether a text is a path by its form. It need not exist now: the adapter may be unplugged."""
    if path.startswith(("/", "./", "../")):
        return True
    return (
        "/" in path
        and ":" not in half_width(path)
        and not path.lower().endswith(".dbcap")
        and not _NAME_IN_DEV.match(path)
    )


def _is_device(path: str) -> bool:
    """Return whether a file name leads to a terminal device, such as the link that ``simulate --link`` makes."""
    try:
        return stat.S_ISCHR(Path(path).stat().st_mode)
    except (OSError, ValueError):
        return False


def _suggestion(text: str) -> str:
    """Return the port URL that was probably meant, in half-width characters, else the command that lists the ports."""
    text = half_width(text)
    if _SCHEME.match(text):
        return text
    if text.lower().endswith(".dbcap"):
        return f"replay://{text}"
    if _NAME_IN_DEV.match(text):
        return f"/dev/{text}"
    if match := _SCHEME_WITHOUT_SLASHES.fullmatch(text):
        return f"{match[1].lower()}://{match[2]}"
    if _SIMULATED.fullmatch(text):
        return f"sim://{text}"
    if _HOST_AND_PORT.fullmatch(text):
        return f"tcp://{text}"
    return "drivebus ports"


def _query(text: str, query: str) -> dict[str, str]:
    if not query:
        return {}
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True)
    except ValueError:
        raise PortUrlError("ports.query", port=text, found=query) from None
    if len(dict(pairs)) != len(pairs):
        raise PortUrlError("ports.query_twice", port=text, found=query)
    return dict(pairs)


def _settings(text: str, baud: str, format: str) -> SerialSettings:
    if not _BAUD.fullmatch(baud) or not 50 <= int(baud) <= 4_000_000:
        raise PortUrlError("ports.baud", port=text, found=baud, expected="50 … 4000000")
    try:
        return SerialSettings.parse(int(baud), format)
    except ValueError:
        raise PortUrlError(
            "ports.format", port=text, found=format, expected=("8N1", "8E1", "8O1", "8N2", "7E1 …")
        ) from None


def _address(text: str, scheme: str, target: str) -> tuple[str, int]:
    if not target:
        raise PortUrlError("ports.url_empty", port=text, scheme=scheme, examples=PORT_URL_EXAMPLES)
    try:
        parts = urlsplit(f"//{target}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host and port is None and not parts.path.strip("/") and "@" not in target and half_width(target) == target:
        raise PortUrlError("ports.no_tcp_port", port=text, scheme=scheme, host=target.strip(":/"))
    if not host or not port or parts.path.strip("/") or "@" in target:
        raise PortUrlError("ports.address", port=text, scheme=scheme, found=target)
    return host, port


def _option_text(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return str(value)


def _float(text: str) -> float | None:
    try:
        return parse_decimal(text)
    except ValueError:
        return None
