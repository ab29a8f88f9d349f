// Announcement of new critical and high alarms to screen readers, on every page.
import { effect, html, signal } from "../lib.js";
import { t } from "../i18n.js";
import { groupAlarms } from "./alarm-groups.js";
import { uncleared, urgentAlarms } from "./alarm-list.js";
import { alarmLine } from "./alarm-strip.js";

/** Time of the text on the page: long enough to be announced, and gone before it could outlast its alarm. */
const SHOWN_MS = 10_000;
/** Time in which a text can be read out before the next one. */
const MIN_INTERVAL_MS = 4000;

const announced = signal("");

/** The most urgent of these alarms, and the number of the others. */
function announcement(alarms) {
  const [equal] = groupAlarms(alarms);
  const others = alarms.length - equal.length;
  const line = t(`page.priority_${equal[0].priority}`) + t("page.colon") + alarmLine(equal);
  return others > 0 ? `${line} · ${t("page.more_alarms", { n: others })}` : line;
}

/** Announce each alarm once; those that follow an announcement closely together, because each text interrupts the one before. */
export function startAlarmAnnouncement() {
  let known = new Set();
  let pending = [];
  let next = null;
  let end = null;
  const announce = () => {
    next = null;
    if (pending.length === 0) return;
    announced.value = announcement(pending);
    pending = [];
    clearTimeout(end);
    end = setTimeout(() => { announced.value = ""; }, SHOWN_MS);
    next = setTimeout(announce, MIN_INTERVAL_MS);
  };
  effect(() => {
    const urgent = uncleared(urgentAlarms());
    const isPending = new Set(pending.map((alarm) => alarm.id));
    pending = urgent.filter((alarm) => isPending.has(alarm.id) || !known.has(alarm.id));
    known = new Set(urgent.map((alarm) => alarm.id));
    if (next === null) announce();
  });
}

/** The live region exists before its text, so that screen readers announce it. */
export const AlarmAnnouncement = () => html`<div class="sr" role="alert" data-text="alarm">${announced.value}</div>`;
