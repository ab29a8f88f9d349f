// Run statistics of one drive.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { moment, quantity } from "../format.js";
import { ErrorNote, Loading, useLoaded } from "../ui.js";

/** Keypad's label of a fault code, as far as the profile has one; else the code, which is negative where it is not known. */
function labelOf(profile, code) {
  if (Number(code) < 0) return t("drives.unnamed_fault");
  return profile?.faults.find((fault) => String(fault.code) === code)?.label || t("page.fault_code", { code });
}

/** `profile`: null until it is loaded. */
export function StatisticsTab({ id, profile }) {
  const [found, error] = useLoaded(() => api.get(drivePath(id, "/statistics")), [id]);
  if (error && !found) return html`<${ErrorNote} error=${error} />`;
  if (!found) return html`<${Loading} />`;
  const faults = Object.entries(found.faults ?? {});
  return html`<dl class="facts"><dt>${t("page.running_h")}</dt><dd>${quantity(found.running_h, "h")}</dd>
    <dt>${t("page.starts")}</dt><dd>${quantity(found.starts)}</dd><dt>${t("page.energy")}</dt>
    <dd>${found.energy_kwh === null ? t("page.energy_unknown") : quantity(found.energy_kwh, "kWh")}</dd>
    <dt>${t("page.maximum_current")}</dt><dd>${quantity(found.maximum_current_a, "A")}</dd>
    <dt>${t("page.maximum_temperature")}</dt><dd>${quantity(found.maximum_temperature_c, "°C")}</dd>
    <dt>${t("page.fault_counts")}</dt><dd>
      ${faults.length ? faults.map(([code, n]) => `${labelOf(profile, code)} × ${n}`).join(t("language.between_items")) : t("page.no_faults")}</dd>
    <dt>${t("page.since")}</dt><dd>${moment(found.since_ms)}</dd></dl>`;
}
