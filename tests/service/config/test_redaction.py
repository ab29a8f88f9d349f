"""Passwords of a configuration are hidden where it is shown."""

from __future__ import annotations

import pytest

from drivebus.errors import ConfigurationError
from drivebus.service.config.redaction import redact_text, redact_url, restore_url


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("postgresql://u:p%40w@h/d", "postgresql://u:…@h/d"),
        ("postgresql://u@h/d", "postgresql://u@h/d"),
        ("postgresql:///d?host=/run/pg&password=hunter2&user=u", "postgresql:///d?host=/run/pg&password=…&user=u"),
        ("mqtt://u:hunter2@h:1883", "mqtt://u:…@h:1883"),
        ("tcp://127.0.0.1:4001?baud=9600", "tcp://127.0.0.1:4001?baud=9600"),
    ],
)
def test_the_password_of_a_url_is_hidden_and_the_user_is_not(url: str, shown: str) -> None:
    assert redact_url(url) == shown


@pytest.mark.parametrize(
    "line",
    [
        'url = "postgresql://u:hunter2@h/d"',
        "url = 'postgresql://u:hunter2@h/d'  # primary",
        'url = """postgresql://u:hunter2@h/d"""',
        'url = "postgresql://u:hun\'ter2@h/d"',
        'url = "postgresql://u:hun@ter2@h/d"',
        'url = "postgresql://u:hun/ter2@h/d"',
        'broker = "mqtt://u:hun@ter2@h"',
        'url = "postgresql://h/d?user=u&password=hunter2"',
        'password = "hunter2"',
        "login = { user = 'u', password = 'hunter2' }",
        'api_token = "hunter2"',
        'url = "postgresql://u:hunter2@h/d"\nopen = ',
    ],
)
def test_no_password_is_in_a_text_that_is_shown(line: str) -> None:
    text = f'[bus.a]\nport = "tcp://127.0.0.1:4001?baud=9600"\n[history]\n{line}\n# contact: li@example.org\n'
    shown = redact_text(text, "plant.toml")
    assert "ter2" not in shown and "…" in shown
    assert "tcp://127.0.0.1:4001" in shown and "li@example.org" in shown


@pytest.mark.parametrize(
    "line",
    [
        'url = "postgresql://u\\u003Ahunter2@h/d"',
        'url = "postgresql:\\u002F/u:hunter2@h/d"',
        'password = """\nhunter2"""',
        '"pass\\u0077ord" = "hunter2"',
        'password = """\nhunter2"""\nopen = ',
        'password = "hun\\"ter2"',
        'password = "hun\\" # ter2"\nopen = ',
        "login = { password = 'hunter2\nopen = ",
        'password = [\n"hunter2"]\nopen = ',
        '"pass\\u0077ord" = "hunter2"\nopen = ',
        'url = "postgresql://u:hun ter2@h/d"\nopen = ',
        'url = "postgresql://u:\nhunter2@h/d"',
        'url = "postgresql:\n//u:hunter2@h/d"',
        'url = "postgresql://h/d?password=hun ter2"\nopen = ',
        '# url = "postgresql://u:hun ter2@h/d"\nopen = ',
        "open = # postgresql://u:hun ter2@h/d",
    ],
)
def test_a_text_whose_password_cannot_be_hidden_is_not_shown(line: str) -> None:
    with pytest.raises(ConfigurationError) as rejected:
        redact_text(f"[history]\n{line}\n", "plant.toml")
    assert rejected.value.key == "plant.password_in_file"


def test_a_text_with_a_number_of_thousands_of_digits_is_shown_without_its_password() -> None:
    text = f'a = {"9" * 5_000}\n[history]\nurl = "postgresql://u:hunter2@h/d"\n'
    assert redact_text(text, "plant.toml") == text.replace("hunter2", "…")


def test_a_hidden_password_is_no_difference_to_the_one_in_use() -> None:
    url = "postgresql://u:hunter2@h/d"
    text = f'[history]\nurl = "{url}"\n'
    assert redact_text(text, "plant.toml") == text.replace(url, redact_url(url))
    assert restore_url(redact_url(url), url) == url
    for other in (None, "", "postgresql://u:…@h/e", f"{redact_url(url)}?x=1", "postgresql://u:hunter3@h/d"):
        assert restore_url(other, url) == other
    assert restore_url(redact_url(url), None) == redact_url(url)
