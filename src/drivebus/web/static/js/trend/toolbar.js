// Toolbar of a trend: span, navigation through time, cursors, and the resolution of its points.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { Button, Choice } from "../ui.js";
import { summary } from "./columns.js";
import { duration, moment } from "./labels.js";
import { SPANS_S, panned } from "./window.js";

const nameOf = (seconds) => t(`page.span_${seconds}`);

export function Toolbar({ view, source }) {
  const { from, to } = view.window.value;
  const span = to - from;
  const chosen = SPANS_S.find((seconds) => Math.abs(seconds * 1000 - span) < 50) ?? null;
  return html`<div class="trend-tools">
    ${!source.isFixed && html`<${Choice} label=${t("page.span")} value=${chosen}
      options=${SPANS_S.map((one) => [one, nameOf(one)])}
      onChange=${(seconds) => view.span_s(seconds)} />`}
    <div class="trend-navigation" role="group" aria-label=${t("page.trend_navigation")}>
      ${tool("page.earlier", "◀", () => view.show(panned(view.window.peek(), -0.5)))}
      ${tool("page.zoom_in", "+", () => view.zoom(0.5))}
      ${tool("page.zoom_out", "−", () => view.zoom(2))}
      ${tool("page.later", "▶", () => view.show(panned(view.window.peek(), 0.5)), view.isLive.value)}
      ${source.isFixed ? html`<${Button}
        onClick=${() => view.show(source.window, { isStep: true })}>${t("page.whole")}<//>` : html`
        <${Button} aria-pressed=${view.isLive.value ? "true" : "false"} class="toggle" data-trend="live"
          onClick=${() => (view.isLive.peek() ? view.pause() : view.follow())}>${t("page.live")}<//>`}
      <${Button} aria-pressed=${view.cursors.value ? "true" : "false"} class="toggle" data-trend="cursors"
        title=${t("page.cursors_title")} aria-label=${t("page.cursors_title")}
        onClick=${() => view.toggleCursors()}>${t("page.cursors")}<//>
    </div>
    <p class="trend-summary"><${Shown} view=${view} source=${source} /></p></div>`;
}

const tool = (key, sign, act, disabled = false) => html`<${Button} key=${key} class="sign" onClick=${act}
  disabled=${disabled} aria-label=${t(key)} title=${t(key)}>${sign}<//>`;

/** Summary of the window: its begin, end and length, and the resolution of its points. */
function Shown({ view, source }) {
  const window = view.window.value;
  const { from, to } = window;
  source.series.value; // with the live samples, which are no signal, in `whole`
  const isEmpty = source.fetched !== null && Object.values(source.whole()).every((one) => summary(one, window) === null);
  const points = isEmpty ? "page.trend_empty" : source.resolution.value && `page.points_${source.resolution.value}`;
  const length = duration(to - from, (unit) => t(`page.unit_${unit}`));
  return html`<span class="trend-window">${moment(from)} – ${moment(to)} · ${length}</span>
    ${points && html` <span>${t(points)}</span>`}
    ${" "}<span class="trend-state" role="status">${source.state.value === "loading" && source.fetched === null
      ? t("page.loading") : ""}${source.error.value ? t("page.trend_failed",
        { why: source.error.value.sentence }) : ""}</span>`;
}
