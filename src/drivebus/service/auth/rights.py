"""Rights and roles. Each operation declares the right that it needs; the service checks it for every caller."""

from __future__ import annotations

from enum import StrEnum

from drivebus import i18n


class Right(StrEnum):
    """Right that an operation needs."""

    VIEW = "view"
    """See drives, buses, frames, history, alarms."""
    STOP = "stop"
    """Stop a drive, a group or everything, without control lease and arm token."""
    OPERATE = "operate"
    """Run, jog, change the setpoint, reset, take a control lease, read parameters and identity over the bus,
    acknowledge and shelve alarms.
    """
    WRITE_PARAMETERS = "write_parameters"
    """Write parameters to the drive's RAM."""
    SAVE = "save"
    """Write parameters to EEPROM; ``write_parameters`` is required as well."""
    LIMIT = "limit"
    """Change limits, record a waiver."""
    CONFIGURE = "configure"
    """Read and reload the plant's configuration."""
    AUDIT = "audit"
    """Read the audit trail."""
    ADMINISTER = "administer"
    """Change users and the tokens of all users."""

    def in_language(self, language: str) -> str:
        """Return the identifier of tokens, API and command line, in Chinese with the name of the right."""
        name = i18n.text(f"page.right_{self.value}", language)
        return f"{name}（{self.value}）" if language == "zh" else self.value


class AccessLevel(StrEnum):
    """Access that is not a right."""

    PUBLIC = "public"
    """No credential, also before the set-up."""
    SESSION = "session"
    """A session of a browser, idle or not."""


RequiredAccess = Right | AccessLevel
"""What an operation requires."""


class Role(StrEnum):
    """Role of a user; each has all rights of the one before."""

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
