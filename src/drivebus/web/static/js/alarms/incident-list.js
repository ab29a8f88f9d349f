// List of incidents: what was recorded each time a drive tripped.
import { html, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { moment } from "../format.js";
import { href } from "../router.js";
import { PagedEnd, usePaged } from "../paged.js";
import { TimeRange, timeRangeQuery } from "../time-range.js";
import { driveTitle } from "../titles.js";

export function IncidentList() {
  const [period, setPeriod] = useState({ span: "month" });
  const query = useMemo(() => timeRangeQuery(period), [period]);
  const list = usePaged("/incidents", query);
  return html`<div class="stack"><p class="help">${t("page.incidents_help")}</p><${TimeRange} value=${period}
    onChange=${setPeriod} />
    <ul class="incidents">${list.items.map((found) => html`<li key=${found.id}><a href=${href("incidents", found.id)}>
      <strong>${driveTitle(found.drive)}</strong>
      <span>${found.title && html`<b>${localized(found.title)}</b> `}${localized(found.text)}</span><time>${moment(found.time_ms)}</time></a></li>`)}</ul>
    <${PagedEnd} list=${list} /></div>`;
}
