// History: trends of any signals of any drives, from a minute to a year, and their export.
import { html, useEffect, useMemo, useRef, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { loadPreference, savePreference } from "../preferences.js";
import { navigations, replaceQuery } from "../router.js";
import { loadStylesheet } from "../stylesheet.js";
import { signalRank } from "../signal-names.js";
import { collator } from "../titles.js";
import { ErrorNote, Loading, Notice, useLoaded } from "../ui.js";
import { Export } from "../trend/export.js";
import { SignalPicker, labelOf } from "../trend/signal-picker.js";
import { HUES } from "../trend/lines.js";
import { Trend } from "../trend/trend.js";

await loadStylesheet("pages");

/** Most signals of one chart; the historian accepts 50. */
const MAX_SIGNALS = 16;
const UPDATE_DELAY_MS = 500;

/** Tags by drive, pump-2 before pump-10, and the most used signals of each drive first. */
async function sortedTags() {
  const { tags } = await api.get("/history/tags");
  return tags.sort((a, b) => collator.compare(a.drive, b.drive) || signalRank(a.signal) - signalRank(b.signal));
}

export function Page({ query }) {
  const [tags, error] = useLoaded(sortedTags, []);
  if (error && !tags) return html`<h1>${t("page.nav_history")}</h1><${ErrorNote} error=${error} />`;
  return html`<h1>${t("page.nav_history")}</h1>${tags ? html`<${SelectedSignals} key=${navigations.value}
    tags=${tags} query=${query} />` : html`<${Loading} />`}`;
}

function SelectedSignals({ tags, query }) {
  const [picked, setPicked] = useState(() => initialTags(tags, query));
  const shown = useRef(null);
  const timer = useRef(null);
  const known = useMemo(() => new Map(tags.map((tag) => [tag.tag, tag])), [tags]);
  const lines = useLines(picked, known);
  const change = (next) => { setPicked(next); savePreference("history", next); };
  const from = Number(query.from) || null;
  const to = Number(query.to) || null;
  // The address follows after a pause in the selection, so that it can be shared.
  const onWindow = (window, live) => {
    shown.current = { window, live };
    clearTimeout(timer.current);
    const fixed = live ? {} : { from: Math.round(window.from), to: Math.round(window.to) };
    timer.current = setTimeout(() => replaceQuery({ tags: picked.join(","), ...fixed }), UPDATE_DELAY_MS);
  };
  useEffect(() => {
    if (shown.current) onWindow(shown.current.window, shown.current.live);
    return () => clearTimeout(timer.current);
  }, [picked]);
  return html`<${SignalPicker} tags=${tags} picked=${picked} most=${MAX_SIGNALS} onChange=${change} />
    ${picked.length === 0 ? html`<${Notice}>${t("page.pick_signals")}<//>` : html`
      <${Trend} lines=${lines} height=${380} span_s=${3600} window=${from && to > from ? { from, to } : null}
        onWindow=${onWindow} onRemove=${(tag) => change(picked.filter((other) => other !== tag))} />
      <${Export} tags=${picked} shown=${() => shown.current.window} />`}`;
}

/** Signals of the address, else those of the last visit, else the output frequencies. */
function initialTags(tags, query) {
  const there = new Set(tags.map((tag) => tag.tag));
  const requested = (query.tags ?? "").split(",").filter((tag) => there.has(tag));
  const last = loadPreference("history", []).filter((tag) => there.has(tag));
  const usual = tags.filter((tag) => tag.signal === "output_frequency").slice(0, 4).map((tag) => tag.tag);
  return [requested, last, usual].find((some) => some.length > 0)?.slice(0, MAX_SIGNALS) ?? [];
}

/** A line keeps its colour while others come and go. */
function useLines(picked, known) {
  const [hues] = useState(() => new Map());
  for (const tag of [...hues.keys()]) if (!picked.includes(tag)) hues.delete(tag);
  for (const tag of picked) {
    if (hues.has(tag)) continue;
    const uses = Array.from({ length: HUES }, (_, hue) => [...hues.values()].filter((used) => used === hue).length);
    hues.set(tag, uses.indexOf(Math.min(...uses)));
  }
  return picked.map((tag) => {
    const found = known.get(tag);
    return { tag, drive: found.drive, label: labelOf(found), unit: found.unit, hue: hues.get(tag) };
  });
}
