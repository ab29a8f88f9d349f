// Equal alarms as one group: the same condition on drives of the same bus. A lost bus raises one for each drive.
import { computed } from "../lib.js";
import { t, titleOf } from "../i18n.js";
import { unacknowledged } from "../alarm-list.js";
import { api } from "../api.js";
import { bus, drive } from "../store.js";
import { driveTitle } from "./titles.js";

/** Fewer equal alarms are rows of their own: a group would need as much room. */
const MIN_EQUAL = 3;
const NAMES_SHOWN = 6;

const buses = new Map();

/** Title of the bus of a drive; "" for an alarm of no drive, or of one that the plant no longer has. */
function busTitle(id) {
  if (!buses.has(id)) buses.set(id, computed(() => {
    const name = drive(id).value?.bus;
    return name ? titleOf(bus(name).value ?? { id: name }) : "";
  }));
  return buses.get(id).value;
}

/** What equal alarms have in common. The value of a fault is its code, that of a threshold only a number. */
const conditionOf = (alarm) => JSON.stringify([alarm.kind, alarm.setting, alarm.priority, alarm.subject,
  busTitle(alarm.drive), alarm.kind === "fault" ? alarm.value : null]);

/** Bus and first names of a group's drives, each once. */
export function groupSubject(alarms) {
  const names = [...new Set(alarms.map((alarm) => (alarm.drive ? driveTitle(alarm.drive) : alarm.subject)))];
  const rest = names.length - NAMES_SHOWN;
  const shown = names.slice(0, NAMES_SHOWN).join(t("page.comma")) + (rest > 0
    ? ` ${t("page.more_alarms", { n: rest })}` : "");
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

/** Acknowledge each alarm by itself, so that each has its audit record. */
export async function acknowledgeEach(alarms) {
  for (const alarm of unacknowledged(alarms)) await acknowledge(alarm);
  return true;
}

async function acknowledge(alarm) {
  try {
    await api.post(`/alarms/${encodeURIComponent(alarm.id)}/acknowledge`);
  } catch (error) {
    if (error.code !== "alarms.unknown") throw error; // another user has acknowledged it meanwhile
  }
}
