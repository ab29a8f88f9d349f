// Alarms: active, shelved and past ones, and incidents.
import { html, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { openAlarms, shelvedAlarms, unacknowledged, uncleared } from "../alarms/alarm-list.js";
import { duration, moment } from "../format.js";
import { isLive } from "../live.js";
import { href, replaceQuery } from "../router.js";
import { may } from "../session.js";
import { loadStylesheet } from "../stylesheet.js";
import { Button, ErrorNote, useRequest, withCommands, withWholeNumbers } from "../ui.js";
import { Tabs } from "../tabs.js";
import { acknowledgeAll } from "../alarms/alarm-groups.js";
import { AcknowledgedBy, AlarmDetails, AlarmRemedy, AlarmRows } from "../alarms/alarm-rows.js";
import { IncidentList } from "../alarms/incident-list.js";
import { PagedEnd, usePaged } from "../paged.js";
import { PriorityMark } from "../alarms/alarm-state.js";
import { TimeRange, timeRangeQuery } from "../time-range.js";

await loadStylesheet("pages");

export function Page({ query }) {
  const [open, shelved] = [openAlarms(), shelvedAlarms()];
  const n = uncleared(open).length;
  const cleared = open.length - n;
  const activeTab = cleared > 0 ? t("page.alarms_active_cleared", { n, cleared }) : t("page.alarms_active", { n });
  const tabs = [
    ["active", activeTab, () => html`<${Active} alarms=${open} />`],
    ["shelved", t("page.alarms_shelved", { n: shelved.length }), () => html`<${Shelved} alarms=${shelved} />`],
    ["history", t("page.alarms_history"), () => html`<${AlarmHistory} />`],
    ["incidents", t("page.incidents"), () => html`<${IncidentList} />`],
  ];
  return html`<h1>${t("page.nav_alarms")}</h1>
    <${Tabs} label=${t("page.nav_alarms")} tabs=${tabs} value=${query.tab ?? "active"}
      onChange=${(tab) => replaceQuery({ ...query, tab })} />`;
}

function Active({ alarms }) {
  const [execute, busy, error] = useRequest();
  const waiting = unacknowledged(alarms);
  return html`<div class="stack">
    ${waiting.length > 1 && may("operate") && html`<div class="row"><${Button} busy=${busy} disabled=${!isLive.value}
      onClick=${() => execute(() => acknowledgeAll(waiting))}>
      ${t("page.acknowledge_all", { n: waiting.length })}<//></div>`}
    <${ErrorNote} error=${error} />
    <${AlarmRows} alarms=${alarms} empty=${t("page.no_alarms")} /></div>`;
}

const Shelved = ({ alarms }) => html`<div class="stack"><p class="help">${t("page.shelved_help")}</p>
  <${AlarmRows} alarms=${alarms} empty=${t("page.none_shelved")} /></div>`;

function AlarmHistory() {
  const [period, setPeriod] = useState({ span: "week" });
  const query = useMemo(() => timeRangeQuery(period), [period]);
  const list = usePaged("/alarms/history", query);
  return html`<div class="stack"><${TimeRange} value=${period} onChange=${setPeriod} />
    <ul class="alarms past">${list.items.map((alarm) => html`<li key=${alarm.id}
      class=${`alarmrow ${alarm.priority} acknowledged cleared`}>
      <${PriorityMark} priority=${alarm.priority} />
      <div class="what"><strong>${localized(alarm.title)}</strong><span><${AlarmDetails} alarm=${alarm} /></span>
        <p>${withCommands(localized(alarm.text))}</p><${AlarmRemedy} alarm=${alarm} /></div>
      <div class="when"><span>${withWholeNumbers(t("page.raised_at", { time: moment(alarm.raised_ms) }))}</span>
        <span>${alarm.cleared_ms === null ? t("page.not_cleared")
          : t("page.cleared_after", { after: duration((alarm.cleared_ms - alarm.raised_ms) / 1000) })}</span>
        ${alarm.acknowledged_ms === null && html`<span>${t("page.not_acknowledged")}</span>`}<${AcknowledgedBy} alarms=${[alarm]} /></div>
      <div class="do">${alarm.incident && html`<a class="button"
        href=${href("incidents", alarm.incident)}>${t("page.open_incident")}</a>`}</div></li>`)}</ul>
    <${PagedEnd} list=${list} /></div>`;
}
