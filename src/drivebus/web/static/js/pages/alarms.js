// Alarms: active, shelved and past ones, and incidents.
import { html, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { isShelved, openAlarms, shelvedAlarms } from "../alarm-list.js";
import { api } from "../api.js";
import { duration, moment } from "../format.js";
import { now, isLive } from "../live.js";
import { href, replaceQuery } from "../router.js";
import { may } from "../session.js";
import { serviceNow } from "../store.js";
import { styled } from "../style.js";
import { Button, ErrorNote, Tabs, useRequest } from "../ui.js";
import { PriorityMark } from "../parts/state.js";
import { AlarmState } from "../parts/alarm-state.js";
import { IncidentList } from "../parts/incident-list.js";
import { PagedEnd, usePaged } from "../parts/paged.js";
import { TimeRange, timeRangeQuery } from "../parts/time-range.js";
import { ShelveDialog } from "../parts/shelve.js";
import { driveTitle } from "../parts/titles.js";

await styled("pages");

export function Page({ query }) {
  const [open, shelved] = [openAlarms(), shelvedAlarms()];
  const tabs = [
    ["active", t("page.alarms_active", { n: open.length }), () => html`<${Active} alarms=${open} />`],
    ["shelved", t("page.alarms_shelved", { n: shelved.length }), () => html`<${Shelved}
      alarms=${shelved} />`],
    ["history", t("page.alarms_history"), () => html`<${AlarmHistory} />`],
    ["incidents", t("page.incidents"), () => html`<${IncidentList} />`],
  ];
  return html`<h1>${t("page.nav_alarms")}</h1>
    <${Tabs} label=${t("page.nav_alarms")} tabs=${tabs} value=${query.tab ?? "active"}
      onChange=${(tab) => replaceQuery({ ...query, tab })} />`;
}

function Active({ alarms }) {
  const [run, busy, error] = useRequest();
  const unacknowledged = alarms.filter((alarm) => alarm.acknowledged_ms === null);
  const all = () => run(async () => {
    for (const alarm of unacknowledged) await api.post(`/alarms/${encodeURIComponent(alarm.id)}/acknowledge`);
  });
  return html`<div class="stack">
    ${unacknowledged.length > 1 && may("operate") && html`<div class="row"><${Button} busy=${busy} disabled=${!isLive.value}
      onClick=${all}>
      ${t("page.acknowledge_all", { n: unacknowledged.length })}<//></div>`}
    <${ErrorNote} error=${error} />
    <${Alarms} alarms=${alarms} empty=${t("page.no_alarms")} /></div>`;
}

const Shelved = ({ alarms }) => html`<div class="stack"><p class="help">${t("page.shelved_help")}</p>
  <${Alarms} alarms=${alarms} empty=${t("page.none_shelved")} /></div>`;

function Alarms({ alarms, empty }) {
  if (alarms.length === 0) return html`<p class="nothing">${empty}</p>`;
  return html`<ul class="alarms">${alarms.map((alarm) => html`<${AlarmRow} key=${alarm.id} alarm=${alarm} />`)}</ul>`;
}

function AlarmRow({ alarm }) {
  const [shelving, setShelving] = useState(false);
  const [run, busy, error] = useRequest();
  const path = `/alarms/${encodeURIComponent(alarm.id)}`;
  const able = may("operate");
  const off = !isLive.value;
  const acknowledged = alarm.acknowledged_ms !== null;
  return html`<li class=${`alarmrow ${alarm.priority} ${acknowledged ? "acknowledged" : "unacknowledged"} ${alarm.cleared_ms === null
    ? "" : "cleared"}`}>
    <${PriorityMark} priority=${alarm.priority} />
    <div class="what"><strong>${localized(alarm.title)}</strong><span><${AlarmDetails} alarm=${alarm} /></span>
      <p>${localized(alarm.text)}</p></div>
    <div class="when"><${AlarmState} alarm=${alarm} />
      <span>${t("page.raised_ago", { age: duration(Math.max(0, plantNowTicking() - alarm.raised_ms) / 1000),
        time: moment(alarm.raised_ms) })}</span>
      ${isShelved(alarm) && html`
        <span>${t("page.shelved_until", { time: moment(alarm.shelved_until_ms) })}</span>
        ${alarm.shelved_by && html`<span>${t("page.shelved_by", { by: alarm.shelved_by, reason: alarm.shelved_reason })}
          </span>`}`}</div>
    <div class="do">
      ${able && !acknowledged && html`<${Button} kind="main" busy=${busy} disabled=${off} data-alarm="acknowledge"
        onClick=${() => run(() => api.post(`${path}/acknowledge`))}>${t("page.acknowledge")}<//>`}
      ${able && !isShelved(alarm) && html`<${Button} disabled=${off}
        onClick=${() => setShelving(true)}>${t("page.shelve")}<//>`}
      ${able && isShelved(alarm) && html`<${Button} busy=${busy} disabled=${off}
        onClick=${() => run(() => api.post(`${path}/unshelve`))}>${t("page.unshelve")}<//>`}
      ${alarm.incident && html`<a class="button" href=${href("incidents", alarm.incident)}>${t("page.open_incident")}</a>`}</div>
    ${error && html`<div class="whole"><${ErrorNote} error=${error} /></div>`}
    ${shelving && html`<${ShelveDialog} alarm=${alarm} onClose=${() => setShelving(false)} />`}</li>`;
}

/** The plant's time, following the page's tick, so that "3 min ago" is updated. */
function plantNowTicking() {
  now.value;
  return serviceNow();
}

/** Subject of an alarm: its drive with a link, or the bus, interlock or store. */
function AlarmDetails({ alarm }) {
  if (!alarm.drive) return alarm.subject ?? "";
  return html`<a href=${href("drive", alarm.drive)}>${driveTitle(alarm.drive)}</a>${alarm.subject
    ? ` · ${alarm.subject}` : ""}`;
}

function AlarmHistory() {
  const [period, setPeriod] = useState({ span: "week" });
  const query = useMemo(() => timeRangeQuery(period), [period]);
  const list = usePaged("/alarms/history", query);
  return html`<div class="stack"><${TimeRange} value=${period} onChange=${setPeriod} />
    <ul class="alarms past">${list.items.map((alarm) => html`<li key=${alarm.id}
      class=${`alarmrow ${alarm.priority} acknowledged cleared`}>
      <${PriorityMark} priority=${alarm.priority} />
      <div class="what"><strong>${localized(alarm.title)}</strong><span><${AlarmDetails} alarm=${alarm} /></span>
        <p>${localized(alarm.text)}</p></div>
      <div class="when"><span>${t("page.raised_at", { time: moment(alarm.raised_ms) })}</span>
        <span>${alarm.cleared_ms === null ? t("page.not_cleared")
          : t("page.cleared_after", { after: duration((alarm.cleared_ms - alarm.raised_ms) / 1000) })}</span>
        <span>${alarm.acknowledged_ms === null ? t("page.not_acknowledged")
          : t("page.acknowledged_by", { by: alarm.acknowledged_by ?? "", time: moment(alarm.acknowledged_ms) })}</span></div>
      <div class="do">${alarm.incident && html`<a class="button"
        href=${href("incidents", alarm.incident)}>${t("page.open_incident")}</a>`}</div></li>`)}</ul>
    <${PagedEnd} list=${list} /></div>`;
}
