// Stop bar at the foot of every page. A bus stop is not an emergency stop, so it has neither the colours nor the shape
// of the red button on the machine.
import { html, signal, useEffect, useLayoutEffect, useRef } from "../lib.js";
import { t } from "../i18n.js";
import { ErrorBoundary } from "../error-boundary.js";
import { clock } from "../format.js";
import { Icon } from "../icons.js";
import { isLive } from "../live.js";
import { route } from "../router.js";
import { may } from "../session.js";
import { usePublishedHeight } from "../published-height.js";
import { drive, idsOf, isAbsent } from "../store.js";
import { dismissStop, shownStops, stop, targetName } from "./stops.js";
import { ReleaseButton } from "./selection.js";
import { StopAnyway } from "./stop-anyway.js";
import { driveTitle, groupTitle, shortened } from "../titles.js";
import { Button, ignoreRepeat, withWholeNumbers } from "../ui.js";

const isMenuOpen = signal(false);

/** Key that leads to the narrowest stop in reach, and with Shift to that of all drives. It stops nothing: Enter does. */
const STOP_KEY = "F8";

/** The stop of the focused tile, else of the drive or the group of the page, else of all: never the button of several groups,
 * at which Enter stops nothing. */
function nearestStop(bar) {
  return document.activeElement?.closest(".tile")?.querySelector(".tilestop")
    ?? bar.querySelector(".stops .stop:not([data-stop=groups])");
}

function useStopKey(bar) {
  useEffect(() => {
    const key = (event) => {
      if (event.key !== STOP_KEY || event.ctrlKey || event.altKey || event.metaKey || !bar.current) return;
      event.preventDefault();
      (event.shiftKey ? bar.current.querySelector("[data-stop=all]") : nearestStop(bar.current))?.focus();
    };
    addEventListener("keydown", key);
    return () => removeEventListener("keydown", key);
  }, []);
}

/** Letters of a name on the two lines of a button of a small screen. */
const SHORT_NAME_LENGTH = 18;

/** Name of what a button stops; a long one also without its middle, for a small screen: that of a drive may begin as that of
 * its group. */
function Name({ name }) {
  const short = shortened(name, SHORT_NAME_LENGTH);
  if (short === name) return withWholeNumbers(name);
  return html`<span class="whole">${withWholeNumbers(name)}</span><span class="short" aria-hidden="true">${withWholeNumbers(short)}</span>`;
}

function StopButton({ kind, id, children, ...rest }) {
  return html`<button type="button" class="stop" data-stop=${kind} onClick=${() => stop(kind, id)} ...${rest}
    onKeyDown=${ignoreRepeat} aria-keyshortcuts=${kind === "all" ? `Shift+${STOP_KEY}` : undefined}
    title=${kind === "all" ? t("page.stop_holds", { key: `Shift+${STOP_KEY}` }) : t("page.stop_holds_not", { key: STOP_KEY })}>
    <${Icon} name="stop" size=${22} /><span><b>${t("page.bus_stop")}</b><span class="what">${children}</span></span>
      </button>`;
}

/** Scope of the page: the drive of its address, the groups of that drive or of the filter; none that the plant lacks. */
function scope() {
  const { page, id, query } = route.value;
  const found = page === "drive" && id && !isAbsent(`drives/${id}`) ? id : null;
  const filter = query.group && !isAbsent(`groups/${query.group}`) ? [query.group] : [];
  return { drive: found, groups: (found && drive(found).value?.groups) || filter };
}

function GroupMenu({ groups }) {
  const menu = useRef(null);
  // Before the paint: a key that follows the first sight of the menu closes it.
  useLayoutEffect(() => {
    const close = (event) => {
      if (event.key !== "Escape") return;
      if (menu.current?.contains(document.activeElement)) document.querySelector("[data-stop=groups]")?.focus();
      isMenuOpen.value = false;
    };
    addEventListener("keydown", close);
    return () => { removeEventListener("keydown", close); isMenuOpen.value = false; };
  }, []);
  return html`<div class="stopmenu" ref=${menu} role="group" aria-label=${t("page.stop_choose_group")}>${groups.map((id) => html`
    <${StopButton} key=${id} kind="group" id=${id}>${groupTitle(id)}<//>`)}</div>`;
}

function GroupStop({ groups }) {
  if (groups.length === 1) return html`<${StopButton} kind="group" id=${groups[0]}><${Name} name=${groupTitle(groups[0])} /><//>`;
  return html`<button type="button" class="stop" aria-expanded=${isMenuOpen.value ? "true" : "false"} data-stop="groups"
    onClick=${() => { isMenuOpen.value = !isMenuOpen.value; }}><${Icon} name="stop" size=${22} />
    <span><b>${t("page.bus_stop")}</b><span class="what">${t("page.stop_scope_group")}</span></span>
    <${Icon} name="more" size=${16} /></button>`;
}

function stopText(entry) {
  const what = targetName(entry.target);
  if (entry.phase === "sending") return t(isLive.value ? "page.stop_sending" : "page.stop_waiting", { what });
  if (entry.phase === "trying") return t("page.stop_trying", { what });
  const key = entry.phase === "failed" ? "page.stop_failed" : entry.good ? "page.stop_done" : "page.stop_not_sure";
  return t(key, { what, why: entry.text(entry.unconfirmed) });
}

export function StopResult({ entry }) {
  const isUnderWay = entry.phase === "sending" || entry.phase === "trying";
  const kind = isUnderWay || entry.acknowledged ? "waiting" : entry.good ? "good" : "bad";
  return html`<div class=${`stop-status ${kind}`}>${kind === "bad" && html`<${Icon} name="fault" />`}
    ${kind === "good" && html`<${Icon} name="check" />`}<div class="result"><span role="alert"><time>${clock(entry.time_ms)}</time>
      ${" "}${stopText(entry)}</span>
      ${may("stop") && entry.withheld?.map((id) => html`<${StopAnyway} key=${id} id=${id} how=${entry.how} />`)}</div>
    ${!isUnderWay && html`<${Button} kind="quiet" icon="close" onClick=${() => dismissStop(entry.id)} data-do="dismiss-stop"
      aria-label=${t("page.stop_dismiss")} title=${t("page.stop_dismiss")} />`}</div>`;
}

function StopResults() {
  const shown = shownStops();
  if (shown.length === 0) return html`<p class="stop-status" role="status">${t("page.stop_note")}</p>`;
  return html`<div class="stop-results">${shown.map((entry) => html`<${StopResult} key=${entry.id} entry=${entry} />`)}</div>`;
}

const ReleaseOfAll = () => html`<${ReleaseButton} views=${idsOf("drives").value.map((id) => drive(id).value).filter(Boolean)} />`;

export function StopBar() {
  const bar = useRef(null);
  usePublishedHeight(bar, "--bar");
  useStopKey(bar);
  if (!may("stop")) return html`<footer class="stopbar" ref=${bar}><p class="stop-status">${t("page.stop_no_right")}</p></footer>`;
  const { drive: id, groups } = scope();
  const every = idsOf("groups").value;
  const offered = groups.length ? groups : every;
  return html`<footer class="stopbar" ref=${bar} aria-label=${t("page.stop_bar")}>
    ${isMenuOpen.value && offered.length > 1 && html`<${GroupMenu} groups=${offered} />`}
    <div class="stops">
      ${id && html`<${StopButton} kind="drive" id=${id}><${Name} name=${driveTitle(id)} /><//>`}
      ${offered.length > 0 && html`<${GroupStop} groups=${offered} />`}
      <${StopButton} kind="all">${t("page.stop_scope_all_held")}<//>
    </div><${ErrorBoundary}>${may("operate") && html`<${ReleaseOfAll} />`}<//><${ErrorBoundary}><${StopResults} /><//></footer>`;
}
