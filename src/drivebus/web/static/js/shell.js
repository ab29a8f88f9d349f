// Frame of every page: header with navigation, connection state, alarm strip, stop bar.
import { effect, html, signal, useEffect, useRef } from "./lib.js";
import { openAlarms, uncleared } from "./alarms/alarm-list.js";
import { AlarmAnnouncement } from "./alarms/alarm-announcement.js";
import { AlarmStrip } from "./alarms/alarm-strip.js";
import { ForeignStopNotices } from "./control/foreign-stop-notices.js";
import { ControlRequestNotices } from "./control/request-notices.js";
import { StopBar } from "./control/stop-bar.js";
import { TakeoverNotices } from "./control/takeover-notices.js";
import { ReplacedDrive } from "./drive/replaced-drive.js";
import { ErrorBoundary } from "./error-boundary.js";
import { duration, moment } from "./format.js";
import { localized, t, titleOf } from "./i18n.js";
import { Icon } from "./icons.js";
import { closedText, connection, isLive, lostAt, now, reconnect } from "./live.js";
import { PreferenceButtons } from "./preference-buttons.js";
import { usePublishedHeight } from "./published-height.js";
import { href, restoreScroll, route } from "./router.js";
import { failedLogout, logout, may, session } from "./session.js";
import { serviceNow, topic } from "./store.js";
import { Button, Notice } from "./ui.js";
import { Unlock } from "./unlock.js";

/** Links of the navigation: a page, and the right that it needs. */
const NAV_PAGES = [
  ["fleet", "view"], ["buses", "view"], ["alarms", "view"], ["history", "view"], ["audit", "audit"],
  ["settings", "view"],
];
/** Page without a link of its own → the page whose link is marked. */
const PARENT_PAGES = { drive: "fleet", models: "settings" };
const isMenuOpen = signal(false);
/** English text of the service's notice that the user has closed. */
const closedNotice = signal("");
/** Session whose notice of failed logins the user has closed. */
const closedLoginNotice = signal("");
/** Version of the service from which the scripts of this page were loaded; null before its first message. */
let loadedVersion = null;

function NavLink({ page }) {
  const here = page === (PARENT_PAGES[route.value.page] ?? route.value.page);
  return html`<a href=${href(page)} aria-current=${here ? "page" : undefined} onClick=${() => { isMenuOpen.value = false; }}>
    ${t(`page.nav_${page}`)}${page === "alarms" && html`<${AlarmCount} />`}</a>`;
}

function AlarmCount() {
  const n = uncleared(openAlarms()).length;
  return html`<span class=${`count ${n > 0 ? "" : "none"}`}>${n}<span class="sr">${t("page.alarms_open")}</span></span>`;
}

function ConnectionMark() {
  const state = connection.value;
  return html`<span class=${`connection ${state}`} role="status"><${Icon} name=${state === "live" ? "link" : "silent"}
    size=${18} />
    <span>${t(`page.link_${state}`)}</span></span>`;
}

/** Time of the print-out: paper keeps its values long after they were live. */
function PrintTime() {
  const line = useRef(null);
  useEffect(() => {
    const show = () => { line.current.textContent = t("page.printed_at", { time: moment(serviceNow()) }); };
    const printing = matchMedia("print");
    addEventListener("beforeprint", show);
    printing.addEventListener("change", show);
    return () => { removeEventListener("beforeprint", show); printing.removeEventListener("change", show); };
  }, []);
  return html`<span class="printed" ref=${line}></span>`;
}

function PageHeader() {
  const plant = topic("plant").value;
  const menu = useRef(null);
  const close = (event) => {
    if (event.key !== "Escape" || !isMenuOpen.value) return;
    isMenuOpen.value = false;
    menu.current.focus(); // what had the focus is hidden now
  };
  return html`<header class="head" onKeyDown=${close}><a class="plant" href=${href("fleet")}>${plant ? titleOf(plant) : "drivebus"}</a><${PrintTime} />
    <button type="button" class="menu" ref=${menu} aria-expanded=${isMenuOpen.value ? "true" : "false"} aria-label=${t("page.menu")}
      onClick=${() => { isMenuOpen.value = !isMenuOpen.value; }}><${Icon} name=${isMenuOpen.value ? "close" : "menu"} size=${24} />
        </button>
    <div class=${`navigation ${isMenuOpen.value ? "open" : ""}`}><nav aria-label=${t("page.navigation")}>
      ${NAV_PAGES.filter(([, right]) => may(right)).map(([page]) => html`<${NavLink} key=${page} page=${page} />`)}</nav>
      <div class="account"><${PreferenceButtons} />
      <span class="user">${session.value.user}</span>
      <${Button} kind="quiet" onClick=${logout}>${t("page.log_out")}<//></div></div><${ConnectionMark} /></header>`;
}

/** Banner while no value is live. */
function ConnectionNotice() {
  if (isLive.value) return null;
  if (connection.value === "starting") return html`<div class="banner info" role="status">${t("page.connecting")}</div>`;
  const age = duration(Math.max(0, now.value - lostAt.value) / 1000);
  const between = t("language.between_sentences");
  return html`<div class="banner bad" role="alert"><${Icon} name="silent" /><span>
    <strong role="timer">${t("page.offline", { age })}</strong>${between}${closedText.value && localized(closedText.value) + between}${t("page.offline_how")}</span>
    <${Button} onClick=${reconnect}>${t("page.reconnect")}<//></div>`;
}

const isNoticeShown = (notice) => Boolean(notice) && notice.en !== closedNotice.value;

/** Page of the address, and whether a notice of the service was shown when it was opened: then it has a place above the page,
 * which stays as long as the page. One that comes later stands over the page, so that it moves no button. */
const noticePlace = signal({ here: null, isReserved: false });
effect(() => {
  const plant = topic("plant").value;
  const here = `${route.value.page}/${route.value.id}`;
  if (plant && noticePlace.peek().here !== here) noticePlace.value = { here, isReserved: isNoticeShown(plant.notice) };
});

/** Notice that the service shows to every user, until the user closes it or another one comes. */
function ServiceNotice() {
  const notice = topic("plant").value?.notice;
  return html`<div role="status">${isNoticeShown(notice) && html`<div class="banner info notice-line" data-text="notice">
    <span>${localized(notice)}</span><${Button} kind="quiet" onClick=${() => { closedNotice.value = notice.en; }} data-do="close-notice">
      ${t("page.close")}<//></div>`}</div>`;
}

const NoticePlace = () => noticePlace.value.isReserved && html`<div class="service-notice"><${ServiceNotice} /></div>`;

/** Notice that the service has another version than when this page was loaded: its scripts are of the old one. */
function NewVersion() {
  const version = topic("plant").value?.version;
  loadedVersion ??= version ?? null;
  const shown = version && version !== loadedVersion;
  return html`<div role="status">${shown && html`<div class="banner high" data-text="new-version"><${Icon} name="warning" />
    <span>${t("page.new_version", { version, loaded: loadedVersion })}</span>
    <${Button} onClick=${() => location.reload()} data-do="reload-page">${t("page.reload_page")}<//></div>`}</div>`;
}

/** Number of wrong passwords since the user's last login, until the user closes it. */
function FailedLogins() {
  const { failed_logins: n, session: id } = session.value;
  const shown = n > 0 && id !== closedLoginNotice.value;
  return html`<div role="status">${shown && html`<div class="banner high" data-text="failed-logins">
    <${Icon} name="warning" /><span>${t("page.failed_logins", { n })}</span>
    <${Button} onClick=${() => { closedLoginNotice.value = id; }}>${t("page.close")}<//></div>`}</div>`;
}

/** Notice of a log-out that the server has not confirmed: the next person at this screen could use the session. */
function LogoutNotice() {
  const failed = failedLogout.value;
  return html`<div role="status">${failed?.session === session.value.session && html`<div class="banner bad" data-text="logout-failed"><${Icon} name="warning" />
    <span>${t("page.logout_failed", { why: failed.error.sentence })}</span>
    <${Button} onClick=${logout}>${t("page.log_out")}<//></div>`}</div>`;
}

function PlantNotice() {
  const plant = topic("plant").value;
  if (!plant) return null;
  return html`${plant.audit_ok === false && html`<${Notice} kind="bad">${t("page.audit_broken")}<//>`}
    ${plant.history_ok === false && html`<${Notice} kind="warning">${t("page.history_broken")}<//>`}
    ${plant.state === "stopping" && html`<${Notice} kind="warning">${t("page.service_stopping")}<//>`}`;
}

/** Notices that come and go by themselves: over the page, so that none moves a button. */
function Notices() {
  const box = useRef(null);
  usePublishedHeight(box, "--notices");
  return html`<div class="notices" ref=${box}><${ConnectionNotice} /><${NewVersion} />${!noticePlace.value.isReserved && html`<${ServiceNotice} />`}<${FailedLogins} />
    <${LogoutNotice} /><${Unlock} />
    <${ReplacedDrive} /><${TakeoverNotices} /><${ForeignStopNotices} /><${ControlRequestNotices} /></div>`;
}

/** `children` is the page of the address. */
export function Shell({ children }) {
  const { page, id } = route.value;
  useEffect(restoreScroll, [page, id]);
  return html`<a class="skip" href="#main"
    onClick=${(event) => { event.preventDefault(); document.getElementById("main").focus(); }}>${t("page.skip")}</a>
    <${ErrorBoundary}><${PageHeader} /><//><${ErrorBoundary}><${Notices} /><//>
    <${ErrorBoundary}><${AlarmAnnouncement} /><${AlarmStrip} /><//>
    <${ErrorBoundary}><${NoticePlace} /><//>
    <main id="main" tabindex="-1" class=${isLive.value ? "" : "stale"}><${ErrorBoundary}><${PlantNotice} /><//>
      <${ErrorBoundary} key=${`${page}/${id}`}>${children}<//></main>
      <${StopBar} />`;
}
