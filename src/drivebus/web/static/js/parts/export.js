// What a trend shows, as a file: the plant writes it, the browser keeps it.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { Button, Choice, ErrorNote, Notice, useAsk } from "../ui.js";
import { saveBlob } from "./save.js";

const RESOLUTIONS = ["raw", "1s", "1min", "1h"];
const FORMATS = ["csv", "parquet"];
const PATIENCE_MS = 600_000;

/** `shown()` gives the window that the chart shows. */
export function Export({ tags, shown }) {
  const [resolution, setResolution] = useState("raw");
  const [format, setFormat] = useState("csv");
  const [run, busy, error, result] = useAsk();
  const save = () => run(async () => {
    const window = shown();
    const query = { tags, from_ms: Math.round(window.from), to_ms: Math.round(window.to), resolution, format };
    const answer = await api.raw("/history/export", query, { patience_ms: PATIENCE_MS });
    const blob = await answer.blob();
    const told = answer.headers.get("Content-Disposition") ?? "";
    const name = /filename="([^"]+)"/.exec(told)?.[1] ?? `drivebus.${format}`;
    saveBlob(name, blob);
    return { name, kb: Math.ceil(blob.size / 1000) };
  });
  return html`<section class="panel stack export"><h2>${t("plantpage.export")}</h2><p
    class="help">${t("plantpage.export_how", { n: tags.length })}</p>
    <div class="row"><${Choice} label=${t("plantpage.resolution")} value=${resolution} onChange=${setResolution}
        options=${RESOLUTIONS.map((one) => [one, t(`plantpage.export_${one}`)])} />
      <${Choice} label=${t("plantpage.format")} value=${format} onChange=${setFormat}
        options=${FORMATS.map((one) => [one, one === "csv" ? "CSV" : "Parquet"])} />
      <${Button} icon="download" busy=${busy} onClick=${save} data-export="save">${t("plantpage.save_file")}<//></div>
    <${ErrorNote} error=${error} />
    ${result && html`<${Notice} kind="good" live>${t("plantpage.saved", result)}<//>`}</section>`;
}
