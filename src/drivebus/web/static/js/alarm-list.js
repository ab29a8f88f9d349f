// The active alarms: those to act on, and the shelved ones.
import { serviceNow, topic } from "./store.js";

const RANK = { critical: 0, high: 1, medium: 2, low: 3 };
const isAcknowledged = (alarm) => alarm.acknowledged_ms !== null;
const byPriority = (one, other) => RANK[one.priority] - RANK[other.priority]
  || isAcknowledged(one) - isAcknowledged(other) || other.raised_ms - one.raised_ms;
const active = () => topic("alarms").value?.active ?? [];

export const isShelved = (alarm) => alarm.shelved_until_ms !== null && alarm.shelved_until_ms > serviceNow();

/** Alarms whose condition still holds; the others wait for their acknowledgement alone. */
export const uncleared = (alarms) => alarms.filter((alarm) => alarm.cleared_ms === null);

export const unacknowledged = (alarms) => alarms.filter((alarm) => !isAcknowledged(alarm));

/** Alarms that are not shelved, by priority, then those that no user has acknowledged, then newest first. */
export const openAlarms = () => active().filter((alarm) => !isShelved(alarm)).sort(byPriority);

/** Shelved alarms in the same order. */
export const shelvedAlarms = () => active().filter(isShelved).sort(byPriority);

/** Alarms that need an operator now: critical or high, not shelved, not acknowledged. */
export const urgentAlarms = () => unacknowledged(openAlarms()).filter((alarm) => RANK[alarm.priority] <= RANK.high);
