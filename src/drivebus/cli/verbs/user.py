"""``user …``: who may log in, changed in the users' file itself: for the machine that the plant runs on."""

from __future__ import annotations

import asyncio
import secrets
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, voice
from drivebus.cli.command import Argument, LazyGroup, OneOf, Option, Verb
from drivebus.cli.server import need_server

if TYPE_CHECKING:
    from drivebus.plant.access.register import Register, User

ROLES = ["viewer", "operator", "engineer", "administrator"]
RIGHTS = ["view", "stop", "operate", "tune", "save", "limit", "configure", "audit", "administer"]
_DAY_MS = 86_400_000


def _add(plant: str, name: str, role: str) -> None:
    from drivebus.plant.access.register import User, plain
    from drivebus.plant.access.rights import Role
    from drivebus.seams import wall_ms

    known = plain(name)
    user = User(known, Role(role), _hash(known), wall_ms())
    _change(plant, "user.add", name, {"role": role}, lambda register: register.added(user))
    voice.document({"name": user.name, "role": role})
    voice.tell("user_verb.added", name=user.name, role=voice.say(f"user_verb.{role}"))


def _list(plant: str) -> None:
    from drivebus.plant.access.offline import file_of
    from drivebus.plant.config import load

    users = file_of(load(plant)).read().users
    voice.document({"users": [_plain(user) for user in users]})
    head = [voice.say(f"user_verb.{column}") for column in ("name", "role", "state")]
    states = [voice.say("user_verb.disabled_state" if user.disabled else "user_verb.enabled_state") for user in users]
    rows = [[user.name, voice.say(f"user_verb.{user.role}"), state] for user, state in zip(users, states, strict=True)]
    voice.show(voice.grid(head, rows)) if users else voice.tell("user_verb.none")


def _passwd(plant: str, name: str) -> None:
    from drivebus.plant.access.offline import file_of
    from drivebus.plant.config import load

    file_of(load(plant)).read().user(name)  # before anybody types a password for nothing
    hashed = _hash(name)
    _change_user(plant, "password", name, {}, lambda user: replace(user, password=hashed))
    _said("user_verb.password_changed", name=name)


def _disable(plant: str, name: str) -> None:
    _change_user(plant, "user.change", name, {"disabled": True}, lambda user: replace(user, disabled=True))
    _said("user_verb.is_disabled", name=name)


def _enable(plant: str, name: str) -> None:
    _change_user(plant, "user.change", name, {"disabled": False}, lambda user: replace(user, disabled=False))
    _said("user_verb.is_enabled", name=name)


def _remove(plant: str, name: str) -> None:
    _change(plant, "user.remove", name, {}, lambda register: register.removed(name))
    _said("user_verb.removed", name=name)


def _token(plant: str, name: str, right: tuple[str, ...], days: int, label: str) -> None:
    from drivebus.plant.access.register import Token, plain
    from drivebus.plant.access.rights import Right
    from drivebus.plant.access.sessions import digest
    from drivebus.seams import wall_ms

    secret, now_ms, rights = "dbt_" + secrets.token_urlsafe(32), wall_ms(), tuple(sorted(Right(one) for one in right))
    made = Token(secrets.token_hex(6), label, plain(name), rights, digest(secret), now_ms, now_ms + days * _DAY_MS)
    told = {"user": name, "rights": list(right), "days": days}
    _change(plant, "token.add", made.id, told, lambda register: register.with_token(made))
    voice.document({"token": secret, "id": made.id, "expires_ms": made.expires_ms})
    voice.note("user_verb.token_once")
    voice.show(secret)


def _change(plant: str, what: str, target: str, params: dict[str, Any], change: Callable[[Register], Register]) -> None:
    from drivebus.plant.access.offline import changed
    from drivebus.plant.config import load

    asyncio.run(changed(load(plant), what, target, params, change))


def _change_user(plant: str, what: str, name: str, params: dict[str, Any], change: Callable[[User], User]) -> None:
    _change(plant, what, name, params, lambda register: register.changed(change(register.user(name))))


def _hash(name: str) -> str:
    """Asked for twice where there is a keyboard, else the first line of standard input."""
    need_server()
    from drivebus.plant.access.passwords import Passwords, check_new

    said = _typed() if sys.stdin.isatty() else sys.stdin.readline().rstrip("\r\n")
    return asyncio.run(Passwords().hash(check_new(said, name)))


def _typed() -> str:
    """The same twice."""
    while True:
        said, again = (
            click.prompt(voice.say(f"user_verb.{key}"), hide_input=True, err=True) for key in ("password", "again")
        )
        if said == again:
            return str(said)
        voice.note("user_verb.differ")


def _said(key: str, **params: str) -> None:
    voice.document(params)
    voice.tell(key, **params)


def _plain(user: User) -> dict[str, Any]:
    return {"name": user.name, "role": str(user.role), "disabled": user.disabled, "created_ms": user.created_ms}


def _verb(
    name: str, callback: Callable[..., None], *options: click.Parameter, example: str, named: bool = True
) -> Verb:
    plant = Argument(["plant"], metavar="PLANT.toml", key="help.argument.plant")
    params = [plant, *([Argument(["name"], key="help.argument.user")] if named else []), *options]
    return Verb(name, topic=f"user.{name}", callback=callback, params=params, examples=(f"drivebus user {example}",))


add = _verb(
    "add",
    _add,
    Option(["--role"], type=OneOf(ROLES), required=True, key="help.option.role", example="--role operator"),
    example="add plant.toml ann --role administrator",
)
listed = _verb("list", _list, example="list plant.toml", named=False)
passwd = _verb("passwd", _passwd, example="passwd plant.toml ann")
disable = _verb("disable", _disable, example="disable plant.toml ann")
enable = _verb("enable", _enable, example="enable plant.toml ann")
remove = _verb("remove", _remove, example="remove plant.toml ann")
token = _verb(
    "token",
    _token,
    Option(
        ["--right"],
        type=OneOf(RIGHTS),
        multiple=True,
        default=["view"],
        key="help.option.right",
        example="--right view",
    ),
    Option(
        ["--days"],
        type=options.Number(1, 366),
        default=90,
        metavar="N",
        key="help.option.days",
        example="--days 30",
    ),
    Option(["--label"], default="command line", key="help.option.label", example="--label scada"),
    example="token plant.toml ann --right view --right stop --days 30",
)

_HERE = "drivebus.cli.verbs.user"
command = LazyGroup(
    "user",
    topic="user",
    sections={
        "cli.section.profile": {
            "add": f"{_HERE}:add",
            "list": f"{_HERE}:listed",
            "passwd": f"{_HERE}:passwd",
            "disable": f"{_HERE}:disable",
            "enable": f"{_HERE}:enable",
            "remove": f"{_HERE}:remove",
            "token": f"{_HERE}:token",
        }
    },
    no_args_is_help=True,
    examples=("drivebus user list plant.toml",),
)
