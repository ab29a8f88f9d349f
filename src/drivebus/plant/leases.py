"""Who may command a drive, and the first step of a start from afar. Pure: ``now`` is an argument (S20)."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from drivebus.errors import ArmNeeded, NotOwner
from drivebus.plant.access.rights import Right
from drivebus.plant.actor import Actor
from drivebus.plant.view import LeaseView

TTL_S = 10.0
"""A lease that nobody renews for so long is over."""
ARM_S = 10.0
"""A start follows its arming within this time (6.5)."""
MOST_ARMS = 100
"""So many arms are kept at once; the oldest goes first (I12)."""


@dataclass(frozen=True, slots=True)
class Lease:
    """One drive's owner until a monotonic second."""

    drive: str
    actor: Actor
    until: float

    def view(self, now: float) -> LeaseView:
        return LeaseView(self.actor.name, self.actor.session, max(0.0, self.until - now))


class Leases:
    """At most one owner a drive."""

    def __init__(self) -> None:
        self._held: dict[str, Lease] = {}
        self._over: list[Lease] = []
        """Ran out, and somebody took the drive before that was told."""

    def get(self, drive: str, now: float) -> Lease | None:
        """The lease in force."""
        lease = self._held.get(drive)
        return lease if lease is not None and now < lease.until else None

    def take(self, drive: str, actor: Actor, now: float) -> Lease | None:
        """Own the drive from now on; returns the lease that was taken from somebody (an engineer may).

        Raises NotOwner where somebody else holds it and the actor may not take it away.
        """
        held = self.get(drive, now)
        taken = held if held is not None and held.actor.session != actor.session else None
        if taken is not None and not actor.may(Right.TUNE):
            raise _owned(taken)
        old = self._held.get(drive)
        if held is None and old is not None and old.actor.session != actor.session:
            self._over.append(old)
        self._held[drive] = Lease(drive, actor, now + TTL_S)
        return taken

    def renew(self, drive: str, actor: Actor, now: float) -> Lease:
        """Ten seconds more. Raises NotOwner where the lease is over or somebody else's."""
        self.need(drive, actor, now)
        lease = self._held[drive] = Lease(drive, actor, now + TTL_S)
        return lease

    def need(self, drive: str, actor: Actor, now: float) -> None:
        """Raises NotOwner unless the actor owns the drive now. Whoever sits at the plant itself takes a free one."""
        held = self.get(drive, now)
        if held is None and not actor.remote:
            self.take(drive, actor, now)
        elif held is None:
            raise NotOwner("plant.no_lease", drive=drive)
        elif held.actor.session != actor.session:
            raise _owned(held)

    def release(self, drive: str, actor: Actor, now: float) -> None:
        """Give it up. Raises NotOwner where it is somebody else's; nothing happens where it is nobody's."""
        held = self.get(drive, now)
        if held is not None and held.actor.session != actor.session:
            raise _owned(held)
        if held is not None:
            del self._held[drive]

    def expired(self, now: float) -> list[Lease]:
        """Leases that have run out, told once."""
        over = [lease for lease in self._held.values() if lease.until <= now]
        for lease in over:
            del self._held[lease.drive]
        before, self._over = self._over, []
        return before + over

    def forget(self, drive: str) -> None:
        """The drive is no longer part of the plant."""
        self._held.pop(drive, None)


def _owned(lease: Lease) -> NotOwner:
    return NotOwner("plant.not_owner", drive=lease.drive, owner=lease.actor.name)


class Arms:
    """First steps that have not been followed yet; each serves once (S16)."""

    def __init__(self) -> None:
        self._live: dict[str, tuple[str, str, float]] = {}

    def arm(self, what: str, actor: Actor, now: float) -> str:
        """A word that lets this session start ``what`` once within ten seconds."""
        while len(self._live) >= MOST_ARMS:
            self._live.pop(next(iter(self._live)))
        word = secrets.token_urlsafe(16)
        self._live[word] = what, actor.session, now + ARM_S
        return word

    def use(self, word: str | None, what: str, actor: Actor, now: float) -> None:
        """Raises ArmNeeded for a remote actor whose word is missing, used, too old, voided or somebody else's."""
        if not actor.remote:
            return
        if word is None:
            raise ArmNeeded("plant.arm_needed", what=what)
        found = self._live.pop(word, None)
        if found is None or found[:2] != (what, actor.session) or now > found[2]:
            raise ArmNeeded("plant.arm_void", what=what, limit_s=ARM_S)

    def void(self, *whats: str) -> None:
        """A stop: whoever armed these before has to arm them anew (6.5)."""
        self._live = {word: one for word, one in self._live.items() if one[0] not in whats}
