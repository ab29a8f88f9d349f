"""Failures of the operating system in the sentences that a user sees: in the language of the user."""

from __future__ import annotations

import ast
import builtins
import errno
import http.client
import os
import re
import socket
import ssl
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import drivebus
from drivebus import i18n
from drivebus.capture.dbcap import read_capture
from drivebus.cli.commands.audit import _readable_trail
from drivebus.cli.errors import from_os_error
from drivebus.commissioning.new_profile.register_table import read_table
from drivebus.drives.store import FileStore
from drivebus.errors import DrivebusError, SystemReason
from drivebus.ports.open_errors import open_error
from drivebus.service.auth.users import UserFile
from drivebus.service.config.load import load
from drivebus.service.process.lock import single_instance
from drivebus.web.server import bind_listener

SOURCE = Path(drivebus.__file__).parent
PREFIX = "system.error_"


@pytest.mark.skipif(sys.platform != "linux", reason="the C libraries of other systems use other words")
@pytest.mark.parametrize("key", sorted(key for key in i18n.catalogue("en") if key.startswith(PREFIX)))
def test_a_reason_of_the_operating_system_keeps_its_words_in_english_and_is_translated(key: str) -> None:
    name = key.removeprefix(PREFIX).upper()
    without_number = {"TIMEOUT": TimeoutError(), "CLOSED": http.client.RemoteDisconnected("")}
    if name.startswith("EAI_"):
        error: OSError = socket.gaierror(getattr(socket, name), "words of the resolver")
    elif name in without_number:
        error = without_number[name]
    else:
        number = getattr(errno, name)
        error = OSError(number, os.strerror(number))
        assert str(SystemReason(error)) == os.strerror(number)
    assert str(SystemReason(error)) == i18n.text(key) != key
    assert re.search("[一-鿿]", SystemReason(error).text("zh"))


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(-2, "words of no system"), "words of no system"),
        (OSError(errno.ENOSYS, "Function not implemented"), "Function not implemented"),
        (ssl.SSLError(errno.EPERM, "[SSL] a number of OpenSSL"), "[SSL] a number of OpenSSL"),
        (ValueError("no OSError"), "no OSError"),
        (OSError(), "OSError"),
    ],
)
def test_an_error_without_a_sentence_keeps_its_words(error: Exception, words: str) -> None:
    """Regression: number 1 of OpenSSL, for any failure of TLS, was taken for the errno "Operation not permitted"."""
    assert SystemReason(error).text("zh") == str(SystemReason(error)) == words


def refused(call: Callable[[], object]) -> DrivebusError:
    with pytest.raises(DrivebusError) as caught:
        call()
    return caught.value


def read_trail(folder: Path) -> None:
    with _readable_trail(folder):
        list(folder.iterdir())


def hold_lock(folder: Path) -> None:
    with single_instance(folder):
        pass


MISSING = ("No such file or directory", "文件或目录不存在")
NO_DIRECTORY = ("Not a directory", "不是目录")
DIRECTORY = ("Is a directory", "是目录，不是文件")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda folder: read_capture(folder), DIRECTORY),
        (lambda folder: read_table(folder, "dec"), DIRECTORY),
        (lambda folder: load(folder / "a.toml"), DIRECTORY),
        (lambda folder: FileStore(folder).get("x"), DIRECTORY),
        (lambda folder: FileStore(folder / "file" / "x").put("x", "y"), ("File exists", "文件已存在")),
        (lambda folder: UserFile(folder).read(), DIRECTORY),
        (lambda folder: UserFile(folder / "file" / "x").read(), NO_DIRECTORY),
        (lambda folder: hold_lock(folder / "file" / "x"), NO_DIRECTORY),
        (lambda folder: read_trail(folder / "x"), MISSING),
        (lambda _: bind_listener("192.0.2.1", 0), ("Cannot assign requested address", "无法使用该地址")),
    ],
)
def test_a_file_or_an_address_that_fails_is_explained_in_both_languages(
    call: Callable[[Path], object], words: tuple[str, str], tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "a.toml").mkdir()
    error = refused(lambda: call(tmp_path))
    for language, word in zip(i18n.LANGUAGES, words, strict=True):
        assert word in error.text(language)
    assert words[0] not in error.text("zh") and "Errno" not in error.text("en")


@pytest.mark.parametrize("make", [from_os_error, lambda error: open_error("/dev/null", error)])
def test_an_error_of_the_system_becomes_a_sentence_in_both_languages(make: Callable[[OSError], DrivebusError]) -> None:
    error = make(OSError(errno.EMFILE, "Too many open files", "/dev/null"))
    assert "Too many open files" in error.text("en")
    assert "打开的文件过多" in error.text("zh")


# --- a rule for every place -------------------------------------------------------------------------------------------


def may_be_system_error(handler: ast.ExceptHandler) -> bool:
    """Return whether a handler can get an OSError."""
    names = {node.id for node in ast.walk(handler.type) if isinstance(node, ast.Name)} if handler.type else set()
    kinds = [kind for name in names if isinstance(kind := getattr(builtins, name, None), type)]
    return any(issubclass(kind, OSError) or issubclass(OSError, kind) for kind in kinds)


def english_reasons(source: str) -> Iterator[str]:
    """Yield each expression that puts words of the system, or a constant text, where a sentence has its reason."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and node.attr == "strerror" and ast.unparse(node.value) != "os":
            yield ast.unparse(node)
        elif isinstance(node, ast.Constant) and node.value == "strerror":
            yield "getattr strerror"
        elif isinstance(node, ast.ExceptHandler) and node.name and may_be_system_error(node):
            words = (f"str({node.name})", f"{{{node.name}}}")
            inner = [ast.unparse(part) for part in ast.walk(node) if isinstance(part, ast.Call | ast.FormattedValue)]
            yield from (expression for expression in inner if expression in words)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("Lost", "Unavailable", "Error")):
            texts = [keyword.value for keyword in node.keywords if keyword.arg in ("reason", "problem")]
            yield from (ast.unparse(text) for text in texts if isinstance(text, ast.Constant | ast.JoinedStr))


@pytest.mark.parametrize(
    "source",
    [
        "x = error.strerror",
        "x = getattr(error, 'strerror', None)",
        "try: pass\nexcept OSError as error: raise X(str(error))",
        "try: pass\nexcept (ValueError, PermissionError) as e: raise X(str(e))",
        "try: pass\nexcept Exception as error: print(f'{error}')",
        "raise PortLost('ports.lost', reason='stalled')",
        "raise ConfigurationError('x.y', problem=f'format {n}')",
    ],
)
def test_the_rule_finds_words_of_the_system(source: str) -> None:
    assert len(list(english_reasons(source))) == 1


def test_no_sentence_gets_the_words_of_the_system_but_through_its_translation() -> None:
    """Regression: about thirty sentences ended in English, such as "No such file or directory", in Chinese too."""
    files = [path for path in sorted(SOURCE.rglob("*.py")) if path.name != "errors.py" or path.parent != SOURCE]
    assert len(files) > 400
    found = {str(path.relative_to(SOURCE)): list(english_reasons(path.read_text(encoding="utf-8"))) for path in files}
    assert {name: reasons for name, reasons in found.items() if reasons} == {}
