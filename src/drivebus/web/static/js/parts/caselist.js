// The cases: what was frozen each time a drive tripped.
import { html, useMemo, useState } from "../lib.js";
import { both, t } from "../i18n.js";
import { moment } from "../format.js";
import { href } from "../router.js";
import { PagedEnd, usePaged } from "./paged.js";
import { Period, asQuery } from "./period.js";
import { driveTitle } from "./titles.js";

export function CaseList() {
  const [period, setPeriod] = useState({ span: "month" });
  const query = useMemo(() => asQuery(period), [period]);
  const list = usePaged("/cases", query);
  return html`<div class="stack"><p class="help">${t("plantpage.cases_help")}</p><${Period} value=${period}
    onChange=${setPeriod} />
    <ul class="cases">${list.items.map((found) => html`<li key=${found.id}><a href=${href("cases", found.id)}>
      <strong>${driveTitle(found.drive)}</strong>
      <span>${both(found.title ?? found.text)}</span><time>${moment(found.time_ms)}</time></a></li>`)}</ul>
    <${PagedEnd} list=${list} /></div>`;
}
