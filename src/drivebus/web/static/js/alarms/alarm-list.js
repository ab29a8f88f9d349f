// The active alarms: those to act on, and the shelved ones.
import { computed } from "../lib.js";
import { serviceNow, topic } from "../store.js";

const RANK = { critical: 0, high: 1, medium: 2, low: 3 };
export const isAcknowledged = (alarm) => alarm.acknowledged_ms !== null;
export const isCleared = (alarm) => alarm.cleared_ms !== null;
const byUrgency = (one, other) => isCleared(one) - isCleared(other) || RANK[one.priority] - RANK[other.priority]
  || isAcknowledged(one) - isAcknowledged(other) || other.raised_ms - one.raised_ms;
const active = () => topic("alarms").value?.active ?? [];

export const isShelved = (alarm) => alarm.shelved_until_ms !== null && alarm.shelved_until_ms > serviceNow();

/** Alarms whose condition still holds; the others wait for their acknowledgement alone. */
export const uncleared = (alarms) => alarms.filter((alarm) => !isCleared(alarm));

export const unacknowledged = (alarms) => alarms.filter((alarm) => !isAcknowledged(alarm));

/** Alarms that are not shelved: those whose condition holds before the cleared ones, then by priority, then those that no
 * user has acknowledged, then newest first. */
export const openAlarms = () => active().filter((alarm) => !isShelved(alarm)).sort(byUrgency);

/** Open alarms of the present drives, without those of a drive whose id a reload has removed or given to another motor. */
const alarmsOfDrives = () => openAlarms().filter((alarm) => !alarm.drive_replaced);

/** First open alarm of each drive. */
const firstByDrive = computed(() => new Map(alarmsOfDrives().reverse().map((alarm) => [alarm.drive, alarm])));

/** The most urgent open alarm of a drive, or undefined. */
export const mostUrgentAlarm = (id) => firstByDrive.value.get(id);

/** Open alarms of a drive whose condition holds, the most urgent first. */
export const activeAlarmsOf = (id) => uncleared(alarmsOfDrives()).filter((alarm) => alarm.drive === id);

const waitingDrives = computed(() => new Set(unacknowledged(alarmsOfDrives()).map((alarm) => alarm.drive)));

/** Whether an open alarm of a drive, active or cleared, waits for its acknowledgement. */
export const hasUnacknowledgedAlarm = (id) => waitingDrives.value.has(id);

/** Whether each open alarm of a drive is cleared, so that it waits for an acknowledgement alone. */
export const hasOnlyClearedAlarms = (id) => {
  const alarm = mostUrgentAlarm(id);
  return alarm !== undefined && isCleared(alarm);
};

/** Shelved alarms in the same order. */
export const shelvedAlarms = () => active().filter(isShelved).sort(byUrgency);

/** Alarms that need an operator now: critical or high, not shelved, not acknowledged. */
export const urgentAlarms = () => unacknowledged(openAlarms()).filter((alarm) => RANK[alarm.priority] <= RANK.high);
