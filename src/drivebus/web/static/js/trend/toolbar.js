// Toolbar of a trend: span, navigation through time, cursors, and the resolution of its points.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { Button, Choice } from "../ui.js";
import { summary } from "./columns.js";
import { moment, spanText } from "../format.js";
import { SPANS_S, panned } from "./window.js";

export function Toolbar({ trend, source }) {
  const { from, to } = trend.window.value;
  const span = to - from;
  const chosen = SPANS_S.find((seconds) => Math.abs(seconds * 1000 - span) < 50) ?? null;
  return html`<div class="trend-tools">
    ${!source.isFixed && html`<${Choice} label=${t("page.span")} value=${chosen}
      options=${SPANS_S.map((seconds) => [seconds, t(`page.span_${seconds}`)])} onChange=${(seconds) => trend.setSpan(seconds)} />`}
    <div class="trend-navigation" role="group" aria-label=${t("page.trend_navigation")}>
      ${toolButton("page.earlier", "◀", () => trend.show(panned(trend.window.peek(), -0.5)))}
      ${toolButton("page.zoom_in", "+", () => trend.zoom(0.5))}
      ${toolButton("page.zoom_out", "−", () => trend.zoom(2))}
      ${toolButton("page.later", "▶", () => trend.show(panned(trend.window.peek(), 0.5)), trend.isLive.value)}
      ${source.isFixed ? html`<${Button}
        onClick=${() => trend.show(source.window, { isStep: true })}>${t("page.whole")}<//>` : html`
        <${Button} aria-pressed=${trend.isLive.value ? "true" : "false"} class="toggle" data-trend="live"
          onClick=${() => (trend.isLive.peek() ? trend.pause() : trend.follow())}>${t("page.live")}<//>`}
      <${Button} aria-pressed=${trend.cursors.value ? "true" : "false"} class="toggle" data-trend="cursors"
        title=${t("page.cursors_title")}
        onClick=${() => trend.toggleCursors()}>${t("page.cursors")}<//></div>
    <p class="trend-summary"><${WindowSummary} trend=${trend} source=${source} /></p></div>`;
}

const toolButton = (key, sign, act, disabled = false) => html`<${Button} key=${key} class="sign" onClick=${act}
  disabled=${disabled} aria-label=${t(key)} title=${t(key)}>${sign}<//>`;

/** Summary of the window: its begin, end and length, and the resolution of its points. */
function WindowSummary({ trend, source }) {
  const window = trend.window.value;
  const { from, to } = window;
  source.series.value; // with the live samples, which are no signal, in `seriesWithLive`
  const isEmpty = source.fetchedWindow !== null && Object.values(source.seriesWithLive()).every((series) => summary(series, window) === null);
  const points = isEmpty ? "page.trend_empty" : source.resolution.value && `page.points_${source.resolution.value}`;
  return html`<span class="trend-window">${moment(from)} – ${moment(to)} ·${" "}
    <span class="span">${spanText(to - from)}</span></span>
    ${points && html` <span>${t(points)}</span>`}
    ${" "}<span class="trend-state" role="status">${source.state.value === "loading" && source.fetchedWindow === null
      ? t("page.loading") : ""}${source.error.value ? t("page.trend_failed",
        { why: source.error.value.sentence }) : ""}</span>`;
}
