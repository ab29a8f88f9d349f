"""Owner and mode of the files that decide who may do what: checked before they are used, as sshd and PostgreSQL do."""

from __future__ import annotations

import grp
import os
import pwd
import shlex
import stat
from collections.abc import Iterator, Set
from contextlib import suppress
from functools import partial
from pathlib import Path

from drivebus.errors import ConfigurationError
from drivebus.profiles.load import own_files
from drivebus.service.audit.chain import AuditPaths
from drivebus.service.config.model import PlantConfig

ROOT = 0


def check_plant_files(config: PlantConfig) -> None:
    """Check plant file, profile files, user file and audit key where they exist, and the folders that they are in.

    A profile decides which frames a drive gets. Raises ConfigurationError.
    """
    audit = AuditPaths.of(config.directory, config.audit.checkpoints, config.audit.key, config.audit.head)
    profiles = {path for model in {drive.model for drive in config.drives} for path in own_files(model)}
    source = [Path(config.source)] if config.source else []
    for path in (*source, config.user_file, audit.key, *sorted(profiles)):
        if path.parent.is_dir():
            _check_folders(path)
        if path.exists():
            check_trusted(path, secret=path == audit.key)
    for path in config.named_paths:
        if any(_links(path)):
            _check_folders(path)
    for path in (*config.named_paths, *config.named_audit_files):  # the folders of these, elsewhere, may have any mode
        _check_links(path)


def certificate_problems(config: PlantConfig) -> Iterator[ConfigurationError]:
    """Yield what is wrong where another user owns or can replace a TLS certificate or its key, or read the key.

    A group may read the key; any other user who reads or replaces it can impersonate the page. A problem does not end
    the service: without a page the drives must still run.
    """
    user = _service_user(config)
    for gateway in config.gateways:
        for files in gateway.certificates if gateway.enabled else ():
            for path in (files.key, files.certificate):
                for check in (
                    partial(check_trusted, path, secret=path == files.key, user=user),
                    partial(_check_folders, path, user),
                ):
                    try:
                        check()
                    except ConfigurationError as error:
                        is_mode = error.key == "plant.secret_readable"
                        yield ConfigurationError("plant.tls_key_mode", **error.params) if is_mode else error
                    except OSError:  # its gateway reports a file that cannot be read
                        continue


def _service_user(config: PlantConfig) -> int:
    """Return the owner of the state directory, as ``check`` may run under another user; without one this user."""
    with suppress(OSError):
        return config.directory.stat().st_uid
    return os.geteuid()


def _check_folders(path: Path, user: int | None = None) -> None:
    """Check that only this user and root can replace a file or a link to it, or write a folder above them.

    In a folder with the sticky bit, as /tmp, others can replace only links of their own, but create what is missing.
    Raises ConfigurationError, OSError.
    """
    _check_links(path, user)
    for child in (*_links(path), path.resolve()):
        for folder in child.parents:
            if not folder.stat().st_mode & stat.S_ISVTX:
                check_trusted(folder, user=user)
            elif not child.exists():
                raise ConfigurationError("plant.shared_folder", path=str(child), folder=str(folder))
            child = folder


def _check_links(path: Path, user: int | None = None) -> None:
    """Check that no other user owns a symbolic link that a name leads over. Raises ConfigurationError, OSError."""
    for link in _links(path):
        _check_owner(link, link.lstat().st_uid, {os.geteuid() if user is None else user, ROOT})


def _links(path: Path) -> Iterator[Path]:
    """Yield each symbolic link that a name leads over: the name, its folders, and those of each target.

    Raises OSError.
    """
    names, found = [path.absolute()], set[Path]()
    for name in names:
        for link in (name, *name.parents):
            if link not in found and link.is_symlink():
                found.add(link)
                names.append(link.parent / link.readlink())
                yield link


def _check_owner(path: Path, owner: int, owners: Set[int]) -> None:
    """Raise ConfigurationError with the command that mends it unless the owner is one of these."""
    if owner not in owners:
        names = {"owner": _user_name(owner), "user": _user_name(min(owners - {ROOT}, default=ROOT))}
        raise ConfigurationError("plant.foreign_owner", path=str(path), quoted=shlex.quote(str(path)), **names)


def check_trusted(path: Path, *, secret: bool = False, root_may_own: bool = True, user: int | None = None) -> None:
    """Check that only this user and root can write a file or folder, and read it if it is a ``secret``.

    ``user``: number of another user in place of this one. Raises ConfigurationError with the command that mends it,
    OSError.
    """
    status, user = path.stat(), os.geteuid() if user is None else user
    _check_owner(path, status.st_uid, {user, ROOT} if root_may_own else {user})
    others = stat.S_IMODE(status.st_mode) & (stat.S_IRWXG | stat.S_IRWXO)
    forbidden = others & (stat.S_IWGRP | stat.S_IWOTH)
    if forbidden == stat.S_IWGRP and _is_private_group(status.st_gid, status.st_uid):
        forbidden = 0
    if secret:
        forbidden |= others & (stat.S_IROTH | stat.S_IWOTH)
    if forbidden:
        key = "plant.secret_readable" if secret else "plant.writable_by_others"
        mode = f"{stat.S_IMODE(status.st_mode):o}"
        raise ConfigurationError(key, path=str(path), quoted=shlex.quote(str(path)), mode=mode)


def _is_private_group(gid: int, uid: int) -> bool:
    """Return whether a group is its user's own, as distributions with umask 002 create it."""
    with suppress(KeyError):
        group, user = grp.getgrgid(gid), pwd.getpwuid(uid)
        return user.pw_gid == gid and group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name}
    return False


def _user_name(uid: int) -> str:
    with suppress(KeyError):
        return pwd.getpwuid(uid).pw_name
    return str(uid)
