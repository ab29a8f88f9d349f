// Export of a trend's samples as a file that the plant writes.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { Button, Choice, ErrorNote, Notice, useRequest } from "../ui.js";
import { saveBlob } from "../save.js";

const RESOLUTIONS = ["raw", "1s", "1min", "1h"];
const FORMATS = ["wide", "csv", "parquet"];
/** Time zone of this browser, for times that a spreadsheet shows as they are. */
const LOCAL_ZONE = Intl.DateTimeFormat().resolvedOptions().timeZone || "UTC";
const EXPORT_TIMEOUT_MS = 600_000;

/** `shown()` gives the window that the chart shows. */
export function Export({ tags, shown }) {
  const [resolution, setResolution] = useState("1s");
  const [format, setFormat] = useState("wide");
  const [zone, setZone] = useState(LOCAL_ZONE);
  const [execute, busy, error, result] = useRequest();
  const save = () => execute(async () => {
    const window = shown();
    const query = { tags, from_ms: Math.round(window.from), to_ms: Math.round(window.to), resolution,
      format: format === "parquet" ? "parquet" : "csv", ...(format === "parquet" ? {} : {
        layout: format === "wide" ? "wide" : "long", timezone: zone }) };
    const answer = await api.raw("/history/export", query, { timeout_ms: EXPORT_TIMEOUT_MS });
    const blob = await answer.blob();
    const disposition = answer.headers.get("Content-Disposition") ?? "";
    const name = /filename="([^"]+)"/.exec(disposition)?.[1] ?? `drivebus.${query.format}`;
    saveBlob(name, blob);
    return { name, kb: Math.ceil(blob.size / 1000) };
  });
  return html`<section class="panel stack export"><h2>${t("page.export")}</h2><p
    class="help">${t("page.export_how", { n: tags.length })}</p>
    <div class="row"><${Choice} label=${t("page.resolution")} value=${resolution} onChange=${setResolution}
        options=${RESOLUTIONS.map((option) => [option, t(`page.export_${option}`)])} />
      <${Choice} label=${t("page.format")} value=${format} onChange=${setFormat}
        options=${FORMATS.map((option) => [option, t(`page.export_format_${option}`)])} />
      ${format !== "parquet" && html`<${Choice} label=${t("page.export_time")} value=${zone} onChange=${setZone}
        options=${[...new Set([LOCAL_ZONE, "UTC"])].map((option) => [option, option])} />`}
      <${Button} icon="download" busy=${busy} onClick=${save} data-export="save">${t("page.save_file")}<//></div>
    <${ErrorNote} error=${error} />
    ${result && html`<${Notice} kind="good" live>${t("page.saved", result)}<//>`}</section>`;
}
