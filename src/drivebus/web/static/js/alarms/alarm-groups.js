// Equal alarms as one group: the same condition on drives of the same bus. A lost bus raises one for each drive.
import { computed } from "../lib.js";
import { hasKey, t, titleOf } from "../i18n.js";
import { isCleared, unacknowledged } from "./alarm-list.js";
import { api } from "../api.js";
import { bus, drive } from "../store.js";
import { collator, driveTitle, shortList } from "../titles.js";

/** Fewer equal alarms are rows of their own: a group would need as much room. */
const MIN_EQUAL = 3;
const MAX_NAMES = 6;
/** The service's limit of the alarms of one request. */
const MAX_SELECTED = 1000;

const buses = new Map();

/** Title of the bus of a drive; "" for an alarm of no drive, or of one that the plant no longer has. */
function busTitle(id) {
  if (!buses.has(id)) buses.set(id, computed(() => {
    const name = drive(id).value?.bus;
    return name ? titleOf(bus(name).value ?? { id: name }) : "";
  }));
  return buses.get(id).value;
}

/** Key of a group: equal alarms have the same. The value of a fault is its code, that of a threshold only a number. Shelved
 * alarms are equal where they were shelved together: their group has one author, reason and end. */
const conditionOf = (alarm) => JSON.stringify([alarm.kind, alarm.title, alarm.setting, alarm.priority, alarm.subject,
  busTitle(alarm.drive), alarm.kind === "fault" ? alarm.value : null,
  alarm.shelved_until_ms, alarm.shelved_by, alarm.shelved_reason]);

/** Key of a group's row: it stays while alarms of the group come, go or are acknowledged. */
export const keyOfGroup = ([alarm]) => conditionOf(alarm);

/** Alarms of a group in an order that their acknowledgement leaves: that of the next one stays where it is. */
export const steadyOrder = (alarms) => [...alarms].sort((one, other) => isCleared(one) - isCleared(other)
  || collator.compare(nameOf(one), nameOf(other)));

/** Name of the subject of an alarm that concerns no drive; a file by itself. */
export const subjectName = (subject) => (hasKey(`alarms.subject.${subject}`) ? t(`alarms.subject.${subject}`) : subject);

/** Name of the drive of an alarm that a reload has removed or replaced since: the present title may be that of another motor. */
export const replacedName = (alarm) => t("page.alarm_drive_replaced", { drive: alarm.drive });

/** Name of an alarm's drive or bus, else of its subject. */
const nameOf = (alarm) => {
  const { drive: id, subject } = alarm;
  if (id) return alarm.drive_replaced ? replacedName(alarm) : driveTitle(id);
  const onBus = subject && bus(subject).value;
  return onBus ? titleOf(onBus) : subjectName(subject);
};

/** "Supply fan: ", to be followed by the alarm's title; "" for an alarm of the whole plant. */
export function alarmSubject(alarm) {
  const name = nameOf(alarm);
  return name ? name + t("page.colon") : "";
}

/** Names of the drives or buses of these alarms, sorted, each once. */
export const subjectNames = (alarms) => shortList([...new Set(alarms.map(nameOf))].sort(collator.compare), MAX_NAMES);

/** Bus and names of a group's drives. */
export function groupSubject(alarms) {
  const shown = subjectNames(alarms);
  const title = busTitle(alarms[0].drive);
  return title ? title + t("page.colon") + shown : shown;
}

/** Lists of equal alarms, in the order of their first alarm. */
export function groupAlarms(alarms) {
  const groups = new Map();
  for (const alarm of alarms) {
    const condition = conditionOf(alarm);
    if (!groups.has(condition)) groups.set(condition, []);
    groups.get(condition).push(alarm);
  }
  return [...groups.values()].flatMap((equal) => (equal.length < MIN_EQUAL ? equal.map((alarm) => [alarm]) : [equal]));
}

/** Acknowledge these alarms with one request, which is one record of the audit trail. */
export const acknowledgeAll = (alarms) => changeAll("acknowledge", unacknowledged(alarms));

/** Shelve these alarms for the same time and reason. */
export const shelveAll = (alarms, minutes, reason) => changeAll("shelve", alarms, { minutes, reason });

export const unshelveAll = (alarms) => changeAll("unshelve", alarms);

/** An alarm that is gone is no error: another user has acknowledged it meanwhile. */
async function changeAll(action, alarms, fields = {}) {
  for (let from = 0; from < alarms.length; from += MAX_SELECTED) {
    const ids = alarms.slice(from, from + MAX_SELECTED).map((alarm) => alarm.id);
    await api.post(`/alarms/${action}`, { alarms: ids, ...fields });
  }
  return true;
}
