// Rows of active alarms: one for each alarm, or one for a group of equal ones that opens.
import { html, useState } from "../lib.js";
import { localized, t, titleOf } from "../i18n.js";
import { isAcknowledged, isCleared, isShelved, unacknowledged, uncleared } from "./alarm-list.js";
import { api } from "../api.js";
import { duration, moment } from "../format.js";
import { isLive, tickingServiceNow } from "../live.js";
import { href } from "../router.js";
import { may } from "../session.js";
import { bus, drive } from "../store.js";
import { Button, ErrorNote, onFirstClick, useRequest, withCommands, withWholeNumbers } from "../ui.js";
import { faultText } from "../drive/faults.js";
import {
  acknowledgeAll, groupAlarms, groupSubject, keyOfGroup, replacedName, steadyOrder, subjectName, subjectNames, unshelveAll,
} from "./alarm-groups.js";
import { AlarmState, PriorityMark } from "./alarm-state.js";
import { ShelveDialog } from "./shelve-dialog.js";
import { driveTitle } from "../titles.js";

/** `alarms` in their order; equal ones as one row. */
export function AlarmRows({ alarms, empty }) {
  if (alarms.length === 0) return html`<p class="nothing">${empty}</p>`;
  return html`<ul class="alarms">${groupAlarms(alarms).map((equal) => (equal.length === 1
    ? html`<${AlarmRow} key=${equal[0].first_id} alarm=${equal[0]} />`
    : html`<${GroupRow} key=${keyOfGroup(equal)} alarms=${equal} />`))}</ul>`;
}

const rowClass = (priority, acknowledged, cleared) => `alarmrow ${priority} ${acknowledged ? "acknowledged"
  : "unacknowledged"} ${cleared ? "cleared" : ""}`;

const raisedAgo = (alarm) => t("page.raised_ago", {
  age: duration(Math.max(0, tickingServiceNow() - alarm.raised_ms) / 1000), time: moment(alarm.raised_ms) });

/** Number and names of the alarms of a group that still hold, and the number of the cleared ones. */
function groupState(alarms) {
  const active = uncleared(alarms);
  const [n, cleared] = [active.length, alarms.length - active.length];
  if (cleared === 0) return t("page.alarm_group_active", { n });
  return n === 0 ? t("page.alarm_group_cleared", { n: cleared })
    : t("page.alarm_group_partly", { n, names: subjectNames(active), cleared });
}

/** The fault that the drives of a group report; the sentence of its oldest alarm where none of them does any more. */
function GroupFault({ alarms, oldest }) {
  const reported = alarms.map((alarm) => drive(alarm.drive).peek()?.fault).find((fault) => fault?.code === oldest.value);
  return html`<p>${reported ? faultText(reported) : withCommands(localized(oldest.text))}</p>`;
}

/** Users who have acknowledged some of these alarms, and the time of the last acknowledgement. */
export function AcknowledgedBy({ alarms }) {
  const done = alarms.filter(isAcknowledged);
  if (done.length === 0) return null;
  const by = [...new Set(done.map((alarm) => alarm.acknowledged_by ?? ""))].join(t("language.between_items"));
  const time = moment(Math.max(...done.map((alarm) => alarm.acknowledged_ms)));
  return html`<span>${withWholeNumbers(t("page.acknowledged_by", { by, time }))}</span>`;
}

function GroupRow({ alarms }) {
  const [open, setOpen] = useState(false);
  const [shelving, setShelving] = useState(false);
  const [execute, busy, error] = useRequest();
  const [first] = alarms;
  const waiting = unacknowledged(alarms);
  const oldest = alarms.reduce((one, other) => (other.raised_ms < one.raised_ms ? other : one));
  return html`<li class=${`${rowClass(first.priority, waiting.length === 0,
    alarms.every(isCleared))} group`}>
    <${PriorityMark} priority=${first.priority} />
    <div class="what"><strong>${t("page.alarm_group", { title: localized(first.title), n: alarms.length })}</strong>
      <span>${withWholeNumbers(groupSubject(alarms))}</span>${first.kind === "fault" && html`<${GroupFault}
        alarms=${alarms} oldest=${oldest} />`}<${AlarmRemedy} alarm=${first} /></div>
    <div class="when"><b>${groupState(alarms)}</b><span>${t("page.alarm_group_open", { n: waiting.length })}</span>
      <${AcknowledgedBy} alarms=${alarms} />
      <span>${withWholeNumbers(t("page.alarm_group_oldest", { age: raisedAgo(oldest) }))}</span><${ShelvedNote} alarm=${first} /></div>
    <div class="do">${may("operate") && waiting.length > 0 && html`<${Button} kind="main" busy=${busy}
      disabled=${!isLive.value} data-alarm="acknowledge" onClick=${onFirstClick(() => execute(() => acknowledgeAll(waiting)))}>
      ${t("page.acknowledge_all", { n: waiting.length })}<//>`}
      ${may("operate") && !isShelved(first) && html`<${Button} disabled=${!isLive.value} data-alarm="shelve"
        onClick=${() => setShelving(true)}>${t("page.shelve_all", { n: alarms.length })}<//>`}
      ${may("operate") && isShelved(first) && html`<${Button} busy=${busy} disabled=${!isLive.value} data-alarm="unshelve"
        onClick=${() => execute(() => unshelveAll(alarms))}>${t("page.unshelve_all", { n: alarms.length })}<//>`}</div>
    ${error && html`<div class="whole"><${ErrorNote} error=${error} /></div>`}
    <details class="whole" open=${open} onToggle=${(event) => setOpen(event.currentTarget.open)}>
      <summary>${t("page.alarm_group_each")}</summary>
      ${open && html`<ul class="alarms">${steadyOrder(alarms).map((alarm) => html`<${AlarmRow} key=${alarm.first_id} alarm=${alarm} />`)}
        </ul>`}</details>
    ${shelving && html`<${ShelveDialog} alarms=${alarms} onClose=${() => setShelving(false)} />`}</li>`;
}

function AlarmRow({ alarm }) {
  const [shelving, setShelving] = useState(false);
  const [execute, busy, error] = useRequest();
  const path = `/alarms/${encodeURIComponent(alarm.id)}`;
  const able = may("operate");
  const off = !isLive.value;
  const acknowledged = isAcknowledged(alarm);
  return html`<li class=${rowClass(alarm.priority, acknowledged, isCleared(alarm))}>
    <${PriorityMark} priority=${alarm.priority} />
    <div class="what"><strong>${localized(alarm.title)}</strong><span><${AlarmDetails} alarm=${alarm} /></span>
      <p>${withCommands(localized(alarm.text))}</p><${AlarmRemedy} alarm=${alarm} /></div>
    <div class="when"><${AlarmState} alarm=${alarm} />
      <${AcknowledgedBy} alarms=${[alarm]} /><span>${withWholeNumbers(raisedAgo(alarm))}</span><${Repetition} alarm=${alarm} /><${ShelvedNote} alarm=${alarm} /></div>
    <div class="do">
      ${able && !acknowledged && html`<${Button} kind="main" busy=${busy} disabled=${off} data-alarm="acknowledge"
        onClick=${onFirstClick(() => execute(() => api.post(`${path}/acknowledge`)))}>${t("page.acknowledge")}<//>`}
      ${able && !isShelved(alarm) && html`<${Button} disabled=${off}
        onClick=${() => setShelving(true)}>${t("page.shelve")}<//>`}
      ${able && isShelved(alarm) && html`<${Button} busy=${busy} disabled=${off}
        onClick=${() => execute(() => api.post(`${path}/unshelve`))}>${t("page.unshelve")}<//>`}
      ${alarm.incident && html`<a class="button" href=${href("incidents", alarm.incident)}>${t("page.open_incident")}</a>`}</div>
    ${error && html`<div class="whole"><${ErrorNote} error=${error} /></div>`}
    ${shelving && html`<${ShelveDialog} alarms=${[alarm]} onClose=${() => setShelving(false)} />`}</li>`;
}

/** How often an alarm was raised without being acknowledged, and when first. */
const Repetition = ({ alarm }) => alarm.count > 1 && html`
  <span>${withWholeNumbers(t("page.alarm_repeated", { n: alarm.count, time: moment(alarm.first_raised_ms) }))}</span>`;

/** End, author and reason of a shelving. */
const ShelvedNote = ({ alarm }) => isShelved(alarm) && html`
  <span>${withWholeNumbers(t("page.shelved_until", { time: moment(alarm.shelved_until_ms) }))}</span>
  ${alarm.shelved_by && html`<span>${t("page.shelved_by", { by: alarm.shelved_by, reason: alarm.shelved_reason })}</span>`}`;

/** Remedy of an alarm, closed until the user opens it. */
export function AlarmRemedy({ alarm }) {
  const remedy = localized(alarm.remedy);
  return remedy && html`<details class="remedy"><summary>${t("page.alarm_remedy")}</summary><p>${withCommands(remedy)}</p></details>`;
}

/** Kinds of alarms whose subject is a bus. */
const BUS_ALARMS = ["port_lost", "foreign_master"];

/** Subject of an alarm: its drive or its bus with a link, or the file or store. The sentence of a drive's alarm names its
 * interlock. */
export function AlarmDetails({ alarm }) {
  const onBus = BUS_ALARMS.includes(alarm.kind) && bus(alarm.subject).value;
  if (!alarm.drive && onBus) return html`<a href=${href("buses", alarm.subject)}>${titleOf(onBus)}</a>`;
  if (!alarm.drive) return subjectName(alarm.subject ?? "");
  if (alarm.drive_replaced) return replacedName(alarm);
  return html`<a href=${href("drive", alarm.drive)}>${driveTitle(alarm.drive)}</a>`;
}
