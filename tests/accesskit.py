"""An ``Access`` in a directory of a test, with users of these roles, who all have the same password."""

from __future__ import annotations

from pathlib import Path

from doorkit import PASSWORD, QUICK, Clock
from drivebus.plant.access.access import Access
from drivebus.plant.access.passwords import Passwords
from drivebus.plant.access.register import User
from drivebus.plant.access.rights import Role
from drivebus.plant.access.visitor import BySession
from drivebus.testing.virtual import run


def empty(directory: Path) -> tuple[Access, Clock]:
    """Before the set-up."""
    clock = Clock()
    return Access(directory, passwords=Passwords(QUICK), clock=clock, wall=clock.wall_ms), clock


def made(directory: Path, *roles: Role) -> tuple[Access, Clock]:
    access, clock = empty(directory)
    hashed = QUICK.hash(PASSWORD)
    for role in roles or (Role.ADMINISTRATOR, Role.OPERATOR):
        access.file.change(lambda register, role=role: register.added(User(str(role), role, hashed, 0)))
    return access, clock


def login(access: Access, name: str = "operator", password: str = PASSWORD) -> tuple[str, BySession]:
    opened = run(access.login(name, password, "127.0.0.1"))
    visitor = access.by_cookie(opened.secret)
    assert visitor is not None
    return opened.secret, visitor


def reborn(access: Access, clock: Clock) -> Access:
    """The web process was killed and started again."""
    return Access(access.setup.path.parent, passwords=access.passwords, clock=clock, wall=clock.wall_ms)
