"""``user``: manage users and tokens in the user file of a plant, on the machine of the service."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, Choice, CliCommand, LazyGroup, Option
from drivebus.cli.extras import require_extra
from drivebus.service.auth.rights import Right, Role

if TYPE_CHECKING:
    from drivebus.service.auth.users import Token, User, UserDatabase


def _add(plant: str, name: str, role: str) -> None:
    from drivebus.clock import wall_ms
    from drivebus.service.auth.names import normalized_name
    from drivebus.service.auth.users import User

    user_name = normalized_name(name)
    user = User(user_name, Role(role), _hash(user_name), wall_ms())
    _change(plant, "user.add", name, {"role": role}, lambda database: database.with_user(user))
    with output.continue_without_output():  # it is done
        output.print_json({"name": user.name, "role": role})
        output.print_message("user_command.added", name=user.name, role=output.text(f"user_command.{role}"))


def _list(plant: str) -> None:
    from drivebus.service.auth.admin import user_file_of
    from drivebus.service.config import load

    users = user_file_of(load(plant)).read().users
    output.print_json({"users": [_user_json(user) for user in users]})
    head = [output.text(f"user_command.{column}") for column in ("name", "role", "state")]
    states = [
        output.text("user_command.disabled_state" if user.disabled else "user_command.enabled_state") for user in users
    ]
    rows = [
        [user.name, output.text(f"user_command.{user.role}"), state] for user, state in zip(users, states, strict=True)
    ]
    output.print_text(output.fitted_table(head, rows)) if users else output.print_message("user_command.none")


def _passwd(plant: str, name: str) -> None:
    from drivebus.service.auth.admin import user_file_of
    from drivebus.service.config import load

    user_file_of(load(plant)).read().user(name)  # check the name before the password is entered
    hashed = _hash(name)
    _change_user(plant, "password", name, {}, lambda user: replace(user, password=hashed))
    _print_done("user_command.password_changed", name=name)


def _disable(plant: str, name: str) -> None:
    _change_user(plant, "user.change", name, {"disabled": True}, lambda user: replace(user, disabled=True))
    _print_done("user_command.is_disabled", name=name)


def _enable(plant: str, name: str) -> None:
    _change_user(plant, "user.change", name, {"disabled": False}, lambda user: replace(user, disabled=False))
    _print_done("user_command.is_enabled", name=name)


def _remove(plant: str, name: str) -> None:
    _change(plant, "user.remove", name, {}, lambda database: database.without_user(name))
    _print_done("user_command.removed", name=name)


def _token(plant: str, name: str, right: tuple[str, ...], days: int, label: str) -> None:
    from drivebus.clock import wall_ms
    from drivebus.service.auth.names import normalized_name
    from drivebus.service.auth.tokens import new_token

    rights = [Right(word) for word in right]
    secret, token = new_token(name=label, user=normalized_name(name), rights=rights, days=days, now_ms=wall_ms())
    params = {"user": name, "rights": list(right), "days": days}
    _change(plant, "token.add", token.id, params, lambda database: database.with_token(token))
    with output.continue_without_output():
        output.print_note("user_command.token_once")
    try:
        output.print_json({"token": secret, "id": token.id, "expires_ms": token.expires_ms})
        output.print_text(secret)
    except OSError:
        _change(plant, "token.remove", token.id, {}, lambda database: database.without_token(token.id))
        output.print_note("user_command.token_lost")
        raise


def _tokens(plant: str) -> None:
    from drivebus.service.auth.admin import user_file_of
    from drivebus.service.config import load

    tokens = user_file_of(load(plant)).read().tokens
    output.print_json({"tokens": [_token_json(token) for token in tokens]})
    head = [output.text(f"user_command.{column}") for column in ("token_id", "name", "label", "rights", "expires")]
    rows = [
        [token.id, token.user, token.name, output.join(token.rights, "items"), _day(token.expires_ms)]
        for token in tokens
    ]
    output.print_text(output.fitted_table(head, rows)) if tokens else output.print_message("user_command.no_tokens")


def _revoke(plant: str, token: str) -> None:
    _change(plant, "token.remove", token, {}, lambda database: database.without_token(token))
    _print_done("user_command.revoked", token=token)


def _day(time_ms: int) -> str:
    return f"{datetime.fromtimestamp(time_ms / 1000, UTC):%Y-%m-%d}"


def _token_json(token: Token) -> dict[str, Any]:
    names = ("id", "name", "user", "rights", "created_ms", "expires_ms")
    return {name: getattr(token, name) for name in names}


def _change(
    plant: str, operation: str, target: str, params: dict[str, Any], change: Callable[[UserDatabase], UserDatabase]
) -> None:
    from drivebus.service.auth.admin import change_users
    from drivebus.service.config import load

    asyncio.run(change_users(load(plant), operation, target, params, change))


def _change_user(plant: str, operation: str, name: str, params: dict[str, Any], change: Callable[[User], User]) -> None:
    _change(plant, operation, name, params, lambda database: database.with_changed_user(change(database.user(name))))


def _hash(name: str) -> str:
    """Hash a password: entered twice on a terminal, else the first line of standard input."""
    from drivebus.errors import ConfigurationError

    require_extra("server")
    from drivebus.service.auth.password_policy import check_password_policy
    from drivebus.service.auth.passwords import PasswordHashing

    password = _prompt_password() if sys.stdin.isatty() else sys.stdin.readline().rstrip("\r\n")
    if not password:
        raise ConfigurationError("user_command.no_password")
    return asyncio.run(PasswordHashing().hash(check_password_policy(password, name)))


def _prompt_password() -> str:
    """Ask for the password until it is entered twice alike."""
    while True:
        password, repeated_password = (
            click.prompt(output.text(f"user_command.{key}"), hide_input=True, err=True) for key in ("password", "again")
        )
        if password == repeated_password:
            return str(password)
        output.print_note("user_command.differ")


def _print_done(key: str, **params: str) -> None:
    with output.continue_without_output():  # it is done
        output.print_json(params)
        output.print_message(key, **params)


def _user_json(user: User) -> dict[str, Any]:
    return {"name": user.name, "role": str(user.role), "disabled": user.disabled, "created_ms": user.created_ms}


def _user_command(
    name: str, callback: Callable[..., None], *options: click.Parameter, example: str, with_name: bool = True
) -> CliCommand:
    plant = Argument(["plant"], metavar="PLANT.toml", key="help.argument.plant")
    params = [plant, *([Argument(["name"], key="help.argument.user")] if with_name else []), *options]
    return CliCommand(
        name, help_key=f"user.{name}", callback=callback, params=params, examples=(f"drivebus user {example}",)
    )


add = _user_command(
    "add",
    _add,
    Option(
        ["--role"],
        type=Choice([str(role) for role in Role]),
        required=True,
        key="help.option.role",
        example="--role operator",
    ),
    example="add plant.toml ann --role administrator",
)
listed = _user_command("list", _list, example="list plant.toml", with_name=False)
passwd = _user_command("passwd", _passwd, example="passwd plant.toml ann")
disable = _user_command("disable", _disable, example="disable plant.toml ann")
enable = _user_command("enable", _enable, example="enable plant.toml ann")
remove = _user_command("remove", _remove, example="remove plant.toml ann")
token = _user_command(
    "token",
    _token,
    Option(
        ["--right"],
        type=Choice([str(right) for right in Right]),
        metavar="RIGHT",
        multiple=True,
        default=["view"],
        key="help.option.right",
        example="--right view",
    ),
    Option(
        ["--days"],
        type=options.NumberType(1, 366),
        default=90,
        metavar="N",
        key="help.option.days",
        example="--days 30",
    ),
    Option(["--label"], default="command line", key="help.option.label", example="--label scada"),
    example="token plant.toml ann --right view --right stop --days 30",
)

tokens = _user_command("tokens", _tokens, example="tokens plant.toml", with_name=False)
revoke = _user_command(
    "revoke",
    _revoke,
    Argument(["token"], metavar="ID", key="help.argument.token"),
    example="revoke plant.toml 5b1f0c52d1aa",
    with_name=False,
)

_MODULE = "drivebus.cli.commands.user"
command = LazyGroup(
    "user",
    help_key="user",
    sections={
        "cli.section.commands": {
            "add": f"{_MODULE}:add",
            "list": f"{_MODULE}:listed",
            "passwd": f"{_MODULE}:passwd",
            "disable": f"{_MODULE}:disable",
            "enable": f"{_MODULE}:enable",
            "remove": f"{_MODULE}:remove",
            "token": f"{_MODULE}:token",
            "tokens": f"{_MODULE}:tokens",
            "revoke": f"{_MODULE}:revoke",
        }
    },
    no_args_is_help=True,
    examples=("drivebus user list plant.toml",),
)
