// Alarms: what is wrong now, what is put aside, what was wrong before, and what was known when a drive tripped.
import { html, useMemo, useState } from "../lib.js";
import { both, t } from "../i18n.js";
import { api } from "../api.js";
import { duration, moment } from "../format.js";
import { now, trusted } from "../live.js";
import { href, replaceQuery } from "../router.js";
import { may } from "../session.js";
import { plantNow, topic } from "../store.js";
import { styled } from "../style.js";
import { Button, ErrorNote, Tabs, useAsk } from "../ui.js";
import { PriorityMark } from "../parts/state.js";
import { AlarmState } from "../parts/alarmstate.js";
import { CaseList } from "../parts/caselist.js";
import { PagedEnd, usePaged } from "../parts/paged.js";
import { Period, asQuery } from "../parts/period.js";
import { ShelveDialog } from "../parts/shelve.js";
import { driveTitle } from "../parts/titles.js";

await styled("pages");

const RANK = { urgent: 0, high: 1, low: 2 };
const byUrgency = (one, other) => RANK[one.priority] - RANK[other.priority] || other.raised_ms - one.raised_ms;
const isShelved = (alarm) => alarm.shelved_until_ms !== null && alarm.shelved_until_ms > plantNow();

export function Page({ query }) {
  const active = topic("alarms").value?.active ?? [];
  const shelved = active.filter(isShelved);
  const open = active.filter((alarm) => !isShelved(alarm)).sort(byUrgency);
  const tabs = [
    ["active", t("plantpage.alarms_active", { n: open.length }), () => html`<${Active} alarms=${open} />`],
    ["shelved", t("plantpage.alarms_shelved", { n: shelved.length }), () => html`<${Shelved}
      alarms=${shelved.sort(byUrgency)} />`],
    ["history", t("plantpage.alarms_history"), () => html`<${Past} />`],
    ["cases", t("plantpage.cases"), () => html`<${CaseList} />`],
  ];
  return html`<h1>${t("page.way_alarms")}</h1>
    <${Tabs} label=${t("page.way_alarms")} tabs=${tabs} value=${query.tab ?? "active"}
      onChange=${(tab) => replaceQuery({ ...query, tab })} />`;
}

function Active({ alarms }) {
  const [run, busy, error] = useAsk();
  const unseen = alarms.filter((alarm) => alarm.acknowledged_ms === null);
  const all = () => run(async () => {
    for (const alarm of unseen) await api.post(`/alarms/${encodeURIComponent(alarm.id)}/acknowledge`);
  });
  return html`<div class="stack">
    ${unseen.length > 1 && may("operate") && html`<div class="row"><${Button} busy=${busy} disabled=${!trusted.value}
      onClick=${all}>
      ${t("plantpage.acknowledge_all", { n: unseen.length })}<//></div>`}
    <${ErrorNote} error=${error} />
    <${Alarms} alarms=${alarms} empty=${t("plantpage.no_alarms")} /></div>`;
}

const Shelved = ({ alarms }) => html`<div class="stack"><p class="help">${t("plantpage.shelved_help")}</p>
  <${Alarms} alarms=${alarms} empty=${t("plantpage.none_shelved")} /></div>`;

function Alarms({ alarms, empty }) {
  if (alarms.length === 0) return html`<p class="nothing">${empty}</p>`;
  return html`<ul class="alarms">${alarms.map((alarm) => html`<${AlarmRow} key=${alarm.id} alarm=${alarm} />`)}</ul>`;
}

function AlarmRow({ alarm }) {
  const [shelving, setShelving] = useState(false);
  const [run, busy, error] = useAsk();
  const path = `/alarms/${encodeURIComponent(alarm.id)}`;
  const able = may("operate");
  const off = !trusted.value;
  const seen = alarm.acknowledged_ms !== null;
  return html`<li class=${`alarmrow ${alarm.priority} ${seen ? "seen" : "unseen"} ${alarm.cleared_ms === null
    ? "" : "over"}`}>
    <${PriorityMark} priority=${alarm.priority} />
    <div class="what"><strong>${both(alarm.title)}</strong><span><${About} alarm=${alarm} /></span>
      <p>${both(alarm.text)}</p></div>
    <div class="when"><${AlarmState} alarm=${alarm} />
      <span>${t("plantpage.raised_ago", { age: duration(Math.max(0, plantNowTicking() - alarm.raised_ms) / 1000),
        time: moment(alarm.raised_ms) })}</span>
      ${isShelved(alarm) && html`
        <span>${t("plantpage.shelved_until", { time: moment(alarm.shelved_until_ms) })}</span>`}</div>
    <div class="do">
      ${able && !seen && html`<${Button} kind="main" busy=${busy} disabled=${off} data-alarm="acknowledge"
        onClick=${() => run(() => api.post(`${path}/acknowledge`))}>${t("plantpage.acknowledge")}<//>`}
      ${able && !isShelved(alarm) && html`<${Button} disabled=${off}
        onClick=${() => setShelving(true)}>${t("plantpage.shelve")}<//>`}
      ${able && isShelved(alarm) && html`<${Button} busy=${busy} disabled=${off}
        onClick=${() => run(() => api.post(`${path}/unshelve`))}>${t("plantpage.unshelve")}<//>`}
      ${alarm.case && html`<a class="button" href=${href("cases", alarm.case)}>${t("plantpage.open_case")}</a>`}</div>
    ${error && html`<div class="whole"><${ErrorNote} error=${error} /></div>`}
    ${shelving && html`<${ShelveDialog} alarm=${alarm} onClose=${() => setShelving(false)} />`}</li>`;
}

/** The plant's time, following the page's tick, so that "3 min ago" grows. */
function plantNowTicking() {
  now.value;
  return plantNow();
}

/** What it is about: its drive, with the way there, or the bus, interlock or store. */
function About({ alarm }) {
  if (!alarm.drive) return alarm.about ?? "";
  return html`<a href=${href("drive", alarm.drive)}>${driveTitle(alarm.drive)}</a>${alarm.about
    ? ` · ${alarm.about}` : ""}`;
}

function Past() {
  const [period, setPeriod] = useState({ span: "week" });
  const query = useMemo(() => asQuery(period), [period]);
  const list = usePaged("/alarms/history", query);
  return html`<div class="stack"><${Period} value=${period} onChange=${setPeriod} />
    <ul class="alarms past">${list.items.map((alarm) => html`<li key=${alarm.id}
      class=${`alarmrow ${alarm.priority} seen over`}>
      <${PriorityMark} priority=${alarm.priority} />
      <div class="what"><strong>${both(alarm.title)}</strong><span><${About} alarm=${alarm} /></span>
        <p>${both(alarm.text)}</p></div>
      <div class="when"><span>${t("plantpage.raised_at", { time: moment(alarm.raised_ms) })}</span>
        <span>${alarm.cleared_ms === null ? t("plantpage.not_cleared")
          : t("plantpage.cleared_after", { after: duration((alarm.cleared_ms - alarm.raised_ms) / 1000) })}</span>
        <span>${alarm.acknowledged_ms === null ? t("plantpage.not_acknowledged")
          : t("plantpage.acknowledged_by", { by: alarm.by ?? "", time: moment(alarm.acknowledged_ms) })}</span></div>
      <div class="do">${alarm.case && html`<a class="button"
        href=${href("cases", alarm.case)}>${t("plantpage.open_case")}</a>`}</div></li>`)}</ul>
    <${PagedEnd} list=${list} /></div>`;
}
