// The trend of one drive's signals, as the history page draws it; loaded when first looked at.
import { html, useEffect, useState } from "../lib.js";
import { t, titled } from "../i18n.js";
import { signalName } from "../format.js";
import { Loading, Notice } from "../ui.js";
import { signalsOf } from "./values.js";

const FIRST = ["output_frequency", "output_current", "set_frequency"];

export function TrendTab({ view }) {
  const [part, setPart] = useState({ Trend: null, failed: false });
  useEffect(() => {
    import("../trend/trend.js").then(
      (found) => setPart({ Trend: found.Trend, failed: false }),
      () => setPart({ Trend: null, failed: true }),
    );
  }, []);
  if (part.failed) return html`<${Notice} kind="bad">${t("page.not_loaded")}<//>`;
  if (!part.Trend) return html`<${Loading} />`;
  const names = signalsOf(view);
  const chosen = FIRST.filter((name) => names.includes(name));
  const lines = (chosen.length ? chosen : names.slice(0, 3)).map((name, hue) => ({
    tag: `${view.id}.${name}`, drive: view.id, label: signalName(name), unit: view.signals[name].unit, hue,
  }));
  return html`<h2 class="sr">${titled(view)}</h2><${part.Trend} lines=${lines} />`;
}
