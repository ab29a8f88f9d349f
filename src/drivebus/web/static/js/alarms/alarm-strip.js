// Strip below the header of every page: the most urgent alarm that waits for its acknowledgement.
import { html } from "../lib.js";
import { localized, t } from "../i18n.js";
import { Icon } from "../icons.js";
import { isLive } from "../live.js";
import { href, route } from "../router.js";
import { may } from "../session.js";
import { drive } from "../store.js";
import { Button, ErrorNote, onFirstClick, useRequest, withCommands } from "../ui.js";
import { acknowledgeAll, alarmSubject, groupAlarms, groupSubject } from "./alarm-groups.js";
import { isCleared, openAlarms, unacknowledged, uncleared } from "./alarm-list.js";
import { PriorityMark } from "./alarm-state.js";

function Acknowledge({ alarms }) {
  const [execute, busy, error] = useRequest();
  const send = onFirstClick(() => execute(() => acknowledgeAll(alarms)));
  return html`<${Button} busy=${busy} disabled=${!isLive.value} onClick=${send} data-do="acknowledge">
    ${alarms.length > 1 ? t("page.acknowledge_all", { n: alarms.length }) : t("page.acknowledge")}<//><${ErrorNote}
    error=${error} />`;
}

/** Most urgent alarm that is not acknowledged, or the group of equal ones that it belongs to; a cleared one only where no
 * condition holds. Its place is reserved: an alarm that comes or goes moves no button. */
export function AlarmStrip() {
  if (route.value.page === "alarms") return null;
  const waiting = unacknowledged(openAlarms());
  const active = uncleared(waiting);
  const [equal] = groupAlarms(active.length > 0 ? active : waiting);
  return html`<section class="strip" aria-label=${t("page.nav_alarms")}>${equal
    ? html`<${StripAlarm} equal=${equal} others=${waiting.length - equal.length} />`
    : isLive.value && html`<p class="strip-calm"><${Icon} name="check" />${t("page.no_alarm_waits")}</p>`}</section>`;
}

/** An alarm in one line, or the group of equal ones. */
export function alarmLine(equal) {
  const [alarm] = equal;
  if (equal.length > 1) return `${t("page.alarm_group", { title: localized(alarm.title), n: equal.length })} · ${groupSubject(equal)}`;
  const titled = (alarm.drive && drive(alarm.drive).value) || isCleared(alarm); // the sentence says what no longer holds
  return titled ? alarmSubject(alarm) + localized(alarm.title) : localized(alarm.text);
}

function StripAlarm({ equal, others }) {
  const [alarm] = equal;
  const cleared = isCleared(alarm);
  const way = alarm.drive && !alarm.drive_replaced && equal.length === 1 ? href("drive", alarm.drive) : href("alarms");
  return html`<div class=${`banner alarm ${alarm.priority} ${cleared ? "cleared" : ""}`}><${PriorityMark}
    priority=${alarm.priority} />${cleared && html`<b class="state">${t("page.alarm_cleared")}</b>`}
    <a href=${way}>${withCommands(alarmLine(equal))}</a>
    ${others > 0 && html`<a class="more" href=${href("alarms")}>${t("page.more_alarms", { n: others })}</a>`}
    ${may("operate") && html`<${Acknowledge} key=${equal.at(-1).first_id} alarms=${equal} />`}</div>`;
}
