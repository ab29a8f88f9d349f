"""Rights and roles: what a person or a program may ask of the plant. Values only.

Every operation (``plant.operations``) names the one right that it needs; the plant itself refuses whoever lacks it,
whatever door the request came through (S01, S08, S09).
"""

from __future__ import annotations

from enum import StrEnum

from drivebus import i18n


class Right(StrEnum):
    """What an operation needs."""

    VIEW = "view"
    """See drives, buses, frames, history, alarms."""
    STOP = "stop"
    """Stop a drive, a group, everything. Needs no lease and no second step."""
    OPERATE = "operate"
    """Run, jog, change the setpoint, reset, take a lease, acknowledge and shelve alarms."""
    WRITE_PARAMETERS = "write_parameters"
    """Write parameters to the drive's RAM."""
    SAVE = "save"
    """Write parameters to EEPROM."""
    LIMIT = "limit"
    """Change limits, record a waiver."""
    CONFIGURE = "configure"
    """Read and reload the plant's configuration."""
    AUDIT = "audit"
    """Read the audit trail."""
    ADMINISTER = "administer"
    """Users and everybody's tokens."""

    @property
    def en(self) -> str:
        """As tokens, the API and the command line write it."""
        return self.value

    @property
    def zh(self) -> str:
        """The word for people, with how it is written."""
        return f"{i18n.text(f'page.right_{self.value}', 'zh')}（{self.value}）"


class Role(StrEnum):
    """What a user is; each role may all that the one before may."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    ENGINEER = "engineer"
    ADMINISTRATOR = "administrator"


_VIEWER_RIGHTS = frozenset({Right.VIEW})
_OPERATOR_RIGHTS = _VIEWER_RIGHTS | {Right.STOP, Right.OPERATE}
_ENGINEER_RIGHTS = _OPERATOR_RIGHTS | {Right.WRITE_PARAMETERS, Right.SAVE, Right.LIMIT, Right.CONFIGURE, Right.AUDIT}

ROLE_RIGHTS: dict[Role, frozenset[Right]] = {
    Role.VIEWER: _VIEWER_RIGHTS,
    Role.OPERATOR: _OPERATOR_RIGHTS,
    Role.ENGINEER: _ENGINEER_RIGHTS,
    Role.ADMINISTRATOR: frozenset(Right),
}
