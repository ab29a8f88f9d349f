"""Control leases of drives, and the tokens of two-step starts. Pure: ``now`` (monotonic seconds) is an argument."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivebus.errors import ArmRequired, ControlNotHeld
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.live.views import LeaseObject
from drivebus.service.runtime.utc_clock import UtcClock

LEASE_TTL_S = 10.0  # a lease ends this long after its last renewal
ARM_TTL_S = 10.0  # a start follows its arming within this time
ENDED_SESSION_TTL_S = 10.0
"""A session that ended takes no control for this time: its commands under way have expired by then.

Not for ever, because a token may get the right to control again.
"""
MAX_ARM_TOKENS = 100  # valid at a time for one session; a further one replaces the oldest


def arm_target_of_test(drive: str) -> str:
    """Return the target of arm tokens for a communication-loss test, which start nothing else."""
    return f"comm-loss-test:{drive}"


def arm_target_of_group(group: str) -> str:
    """Return the target of arm tokens for the start of a group."""
    return f"group:{group}"


@dataclass(frozen=True, slots=True)
class ControlLease:
    """Control of one drive by one session until ``expires_at``, in monotonic seconds."""

    drive: str
    actor: Actor
    expires_at: float
    claimed: bool = True
    """False for one that was handed over and not used since: at its end it counts as released, not as lost."""

    def view(self, clock: UtcClock) -> LeaseObject:
        actor = self.actor
        return LeaseObject(actor.name, actor.session, actor.remote, clock.utc_ms(self.expires_at))


class ControlLeases:
    """Control leases of all drives: at most one for each."""

    def __init__(self, on_control_end: Callable[[str], None] = lambda drive: None) -> None:
        """``on_control_end`` is called with a drive whenever the session that controlled it no longer does."""
        self._on_control_end = on_control_end
        self._leases: dict[str, ControlLease] = {}
        self._replaced_expired: list[ControlLease] = []
        """Ended leases whose drive was taken again before ``pop_expired`` returned them."""
        self._ended_sessions: dict[str, float] = {}
        """Session → monotonic time until which it takes no control."""

    def get(self, drive: str, now: float) -> ControlLease | None:
        """Return the lease in force; None if the drive has none."""
        lease = self._leases.get(drive)
        return lease if lease is not None and now < lease.expires_at else None

    def controls(self, drive: str, actor: Actor, now: float) -> bool:
        """Return whether the session of the actor controls a drive."""
        lease = self.get(drive, now)
        return lease is not None and lease.actor.is_same_session(actor)

    def take(self, drive: str, actor: Actor, now: float) -> ControlLease | None:
        """Give the actor control and return the lease of another session that this ended; an engineer may take one.

        Raises ControlNotHeld where another session has control and the actor may not take it, and for an ended session.
        """
        if self.has_ended(actor.session, now):
            raise ControlNotHeld("plant.session_has_ended", drive=drive)
        lease = self.get(drive, now)
        other = lease if lease is not None and not lease.actor.is_same_session(actor) else None
        if other is not None and not actor.may(Right.WRITE_PARAMETERS):
            raise _not_owner_error(other)
        old = self._leases.get(drive)
        self._leases[drive] = ControlLease(drive, actor, now + LEASE_TTL_S)
        if old is not None and not old.actor.is_same_session(actor):
            if other is None:
                self._replaced_expired.append(old)
            self._on_control_end(drive)
        return other

    def renew(self, drive: str, actor: Actor, now: float) -> ControlLease:
        """Extend a lease. Raises ControlNotHeld where it has ended or is another session's."""
        self.require(drive, actor, now)
        lease = self._leases[drive] = ControlLease(drive, actor, now + LEASE_TTL_S)
        return lease

    def require(self, drive: str, actor: Actor, now: float) -> None:
        """Raise ControlNotHeld unless the actor owns the drive now; a local actor takes a free one."""
        if self.get(drive, now) is None and not actor.remote:
            self.take(drive, actor, now)
            return
        lease = self.require_own(drive, actor, now)
        if not lease.claimed:
            self._leases[drive] = replace(lease, claimed=True)

    def require_own(self, drive: str, actor: Actor, now: float) -> ControlLease:
        """Return the lease of the actor. Raises ControlNotHeld unless the actor has control of the drive now."""
        lease = self.get(drive, now)
        if lease is None:
            raise ControlNotHeld("plant.no_lease", drive=drive)
        if not lease.actor.is_same_session(actor):
            raise _not_owner_error(lease)
        return lease

    def require_answerable(self, drive: str, actor: Actor, now: float) -> ControlLease:
        """Return the lease whose holder ``actor`` answers for: its own, or on the local socket that of the same user.

        Raises ControlNotHeld.
        """
        lease = self.get(drive, now)
        # Each command on that socket has a session of its own, so the answer comes from another terminal. Only the
        # user of the service opens the socket (mode 0600).
        if lease is not None and lease.actor.is_same_local_user(actor):
            return lease
        return self.require_own(drive, actor, now)

    def hand_over(self, drive: str, actor: Actor, to: Actor, now: float) -> None:
        """Release the lease of ``actor`` to ``to``, which has to use it before it ends. Raises ControlNotHeld."""
        self.require_answerable(drive, actor, now)
        self._leases[drive] = ControlLease(drive, to, now + LEASE_TTL_S, claimed=False)
        self._on_control_end(drive)

    def release(self, drive: str, actor: Actor, now: float) -> None:
        """End a lease; there may be none. Raises ControlNotHeld where it is another session's."""
        lease = self.get(drive, now)
        if lease is not None and not lease.actor.is_same_session(actor):
            raise _not_owner_error(lease)
        if lease is not None:
            self._end(lease)

    def _end(self, lease: ControlLease) -> None:
        del self._leases[lease.drive]
        self._on_control_end(lease.drive)

    def pop_expired(self, now: float) -> list[ControlLease]:
        """Return each lease that has ended since the last call."""
        over = [lease for lease in self._leases.values() if lease.expires_at <= now]
        for lease in over:
            self._end(lease)
        before, self._replaced_expired = self._replaced_expired, []
        return before + over

    def end_session(self, session: str, now: float) -> list[ControlLease]:
        """End the leases of a session that has ended and return them; for a moment it takes no other."""
        self._ended_sessions = {ended: until for ended, until in self._ended_sessions.items() if now < until}
        self._ended_sessions[session] = now + ENDED_SESSION_TTL_S
        leases = [lease for drive in self._leases if (lease := self.get(drive, now)) and lease.actor.session == session]
        for lease in leases:
            self._end(lease)
        return leases

    def has_ended(self, session: str, now: float) -> bool:
        """Return whether a session ended within ``ENDED_SESSION_TTL_S``."""
        return now < self._ended_sessions.get(session, now)

    def remove_drive(self, drive: str) -> None:
        """Drop the lease of a drive that was removed from the plant, or replaced. Idempotent."""
        self._leases.pop(drive, None)


def _not_owner_error(lease: ControlLease) -> ControlNotHeld:
    return ControlNotHeld("plant.not_owner", drive=lease.drive, owner=lease.actor.name)


@dataclass(frozen=True, slots=True)
class IssuedArm:
    """Permission of one session to start ``target`` until ``expires_at``, in monotonic seconds."""

    target: str
    """A drive, or what ``arm_target_of_group`` or ``arm_target_of_test`` returns."""
    session: str
    expires_at: float


class ArmTokens:
    """Tokens of first steps of a start; each is valid once."""

    def __init__(self) -> None:
        self._tokens: dict[str, IssuedArm] = {}

    def issue(self, target: str, actor: Actor, now: float) -> str:
        """Return a token for one start of ``target`` by this session within ``ARM_TTL_S``."""
        self._tokens = {token: issued for token, issued in self._tokens.items() if now <= issued.expires_at}
        own = [token for token, issued in self._tokens.items() if issued.session == actor.session]
        if len(own) >= MAX_ARM_TOKENS:
            del self._tokens[own[0]]
        token = secrets.token_urlsafe(16)
        self._tokens[token] = IssuedArm(target, actor.session, now + ARM_TTL_S)
        return token

    def consume(self, token: str | None, target: str, actor: Actor, now: float) -> None:
        """Raise ArmRequired unless a remote actor's token was issued to it for this start and is unused."""
        if not actor.remote:
            return
        if token is None:
            raise ArmRequired("plant.arm_needed", what=target)
        issued = self._tokens.pop(token, None)
        fits = issued is not None and (issued.target, issued.session) == (target, actor.session)
        if issued is None or not fits or now > issued.expires_at:
            raise ArmRequired("plant.arm_void", what=target, limit_s=ARM_TTL_S)

    def revoke(self, *targets: str) -> None:
        """Invalidate the tokens of these drives and groups: after a stop each start has to be armed again."""
        self._tokens = {token: issued for token, issued in self._tokens.items() if issued.target not in targets}
