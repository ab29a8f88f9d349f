// Trend of one drive's signals, as on the history page; loaded when first opened.
import { html, useEffect, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { signalName, signalRank } from "../signal-names.js";
import { HUES, firstLines } from "../trend/lines.js";
import { ErrorNote, Loading, Notice, toggled, useLoaded } from "../ui.js";

/** Signals shown at first. */
const DEFAULT_SIGNAL_COUNT = 3;

async function tagsOf(id) {
  const { tags } = await api.get("/history/tags");
  return tags.filter((tag) => tag.drive === id).sort((a, b) => signalRank(a.signal) - signalRank(b.signal));
}

function Pick({ tags, chosen, onChange }) {
  return html`<details><summary>${t("page.signals_chosen", { n: `${chosen.length}/${tags.length}` })}</summary>
    <fieldset class="row trendpick"><legend class="sr">${t("page.signals")}</legend>${tags.map((tag) => html`
      <label class="check" key=${tag.tag}><input type="checkbox" checked=${chosen.includes(tag.tag)}
        onChange=${() => onChange(toggled(chosen, tag.tag))} />${signalName(tag.signal)}</label>`)}</fieldset></details>`;
}

export function TrendTab({ view }) {
  const [part, setPart] = useState({ Trend: null, failed: false });
  const [tags, error] = useLoaded(() => tagsOf(view.id), [view.id]);
  const [picked, setPicked] = useState(null);
  useEffect(() => {
    import("../trend/trend.js").then(
      (found) => setPart({ Trend: found.Trend, failed: false }),
      () => setPart({ Trend: null, failed: true }),
    );
  }, []);
  if (part.failed) return html`<${Notice} kind="bad">${t("page.not_loaded")}<//>`;
  if (error && !tags) return html`<${ErrorNote} error=${error} />`;
  if (!part.Trend || !tags) return html`<${Loading} />`;
  if (tags.length === 0) return html`<p class="loading">${t("page.no_history")}</p>`;
  const chosen = picked ?? firstLines(tags).slice(0, DEFAULT_SIGNAL_COUNT).map((tag) => tag.tag);
  const lines = tags.map((tag, hue) => ({
    tag: tag.tag, drive: view.id, label: signalName(tag.signal), unit: tag.unit, hue: hue % HUES,
  })).filter((line) => chosen.includes(line.tag));
  return html`<${Pick} tags=${tags} chosen=${chosen} onChange=${setPicked} />
    ${lines.length === 0 ? html`<${Notice}>${t("page.pick_signals")}<//>` : html`<${part.Trend} lines=${lines} />`}`;
}
