// Frame of every page: header with navigation, connection state, alarm strip, stop bar.
import { html, signal, useEffect, useRef } from "./lib.js";
import { LANGUAGES, localized, chooseLanguage, language, t, titleOf } from "./i18n.js";
import { THEMES, chooseTheme, themeChoice } from "./theme.js";
import { clock, duration } from "./format.js";
import { isCleared, openAlarms, unacknowledged, uncleared } from "./alarms/alarm-list.js";
import { chooseSound, isSoundOn } from "./alarms/alarm-sound.js";
import { Icon } from "./icons.js";
import { Button, ErrorNote, Notice, useRequest } from "./ui.js";
import { closedText, connection, isLive, lostAt, now, reconnect } from "./live.js";
import { href, route } from "./router.js";
import { logout, may, session } from "./session.js";
import { usePublishedHeight } from "./published-height.js";
import { drive, topic } from "./store.js";
import { acknowledgeAll, alarmSubject, groupAlarms, groupSubject } from "./alarms/alarm-groups.js";
import { ControlRequestNotices } from "./control/request-notices.js";
import { listed } from "./control/selection.js";
import { PriorityMark } from "./drive/state-mark.js";
import { Unlock } from "./unlock.js";
import { StopBar } from "./control/stop-bar.js";
import { dismiss, groupTakeovers, takeovers } from "./control/takeovers.js";

/** Page → the right that it needs. */
const NAV_PAGES = [
  ["fleet", "view"], ["buses", "view"], ["alarms", "view"], ["history", "view"], ["audit", "audit"],
  ["settings", "view"],
];
/** Page without a link of its own → the page whose link is marked. */
const PARENT_PAGES = { drive: "fleet", models: "settings" };
const menu = signal(false);
/** English text of the service's notice that the user has closed. */
const closedNotice = signal("");
const closedLoginNotice = signal("");

function NavLink({ page }) {
  const open = page === "alarms" ? uncleared(openAlarms()).length : 0;
  const here = page === (PARENT_PAGES[route.value.page] ?? route.value.page);
  return html`<a href=${href(page)} aria-current=${here ? "page" : undefined} onClick=${() => { menu.value = false; }}>
    ${t(`page.nav_${page}`)}${page === "alarms" && html`<span class=${`count ${open > 0 ? "" : "none"}`}>${open}<span class="sr">
      ${t("page.alarms_open")}</span></span>`}</a>`;
}

function ConnectionMark() {
  const state = connection.value;
  return html`<span class=${`line ${state}`} role="status"><${Icon} name=${state === "live" ? "link" : "silent"}
    size=${18} />
    <span>${t(`page.link_${state}`)}</span></span>`;
}

export function Preferences() {
  const other = language.value === "zh" ? "en" : "zh";
  const next = THEMES[(THEMES.indexOf(themeChoice.value) + 1) % THEMES.length];
  return html`<${Button} kind="quiet" lang=${other === "zh" ? "zh-CN" : "en"} onClick=${() => chooseLanguage(other)}>
    ${LANGUAGES[other]}<//>
    <${Button} kind="quiet" icon="sun" onClick=${() => chooseTheme(next)}
      aria-label=${t("page.theme_is", { now: t(`page.theme_${themeChoice.value}`), next: t(`page.theme_${next}`) })}>
      ${t(`page.theme_${themeChoice.value}`)}<//>
    ${session.value.user && html`<${Button} kind="quiet" icon=${isSoundOn.value ? "sound" : "silenced"} data-do="sound"
      aria-pressed=${isSoundOn.value ? "true" : "false"} aria-label=${t("page.alarm_sound")}
      title=${t(isSoundOn.value ? "page.alarm_sound_on" : "page.alarm_sound_off")}
      onClick=${() => chooseSound(!isSoundOn.value)} />`}`;
}

function PageHeader() {
  const plant = topic("plant").value;
  return html`<header class="head"><a class="plant" href=${href("fleet")}>${plant ? titleOf(plant) : "drivebus"}</a>
    <button type="button" class="menu" aria-expanded=${menu.value ? "true" : "false"} aria-label=${t("page.menu")}
      onClick=${() => { menu.value = !menu.value; }}><${Icon} name=${menu.value ? "close" : "menu"} size=${24} />
        </button>
    <div class=${`ways ${menu.value ? "open" : ""}`}><nav aria-label=${t("page.navigation")}>
      ${NAV_PAGES.filter(([, right]) => may(right)).map(([page]) => html`<${NavLink} key=${page} page=${page} />`)}</nav>
      <div class="account"><${Preferences} />
      <span class="user">${session.value.user}</span>
      <${Button} kind="quiet" onClick=${logout}>${t("page.log_out")}<//></div></div><${ConnectionMark} /></header>`;
}

/** Banner while no value is live. */
function ConnectionNotice() {
  if (connection.value === "live") return null;
  if (connection.value === "starting") return html`<div class="banner info" role="status">${t("page.connecting")}</div>`;
  const age = duration(Math.max(0, now.value - lostAt.value) / 1000);
  return html`<div class="banner bad" role="alert"><${Icon} name="silent" /><span>
    <strong role="timer">${t("page.offline", { age })}</strong>${" "}${closedText.value ? localized(closedText.value)
      : t("page.offline_how")}</span>
    <${Button} onClick=${reconnect}>${t("page.reconnect")}<//></div>`;
}

function Acknowledge({ alarms }) {
  const [run, busy, error] = useRequest();
  const send = () => run(() => acknowledgeAll(alarms));
  return html`<${Button} busy=${busy} disabled=${connection.value !== "live"} onClick=${send} data-do="acknowledge">
    ${alarms.length > 1 ? t("page.acknowledge_all", { n: alarms.length }) : t("page.acknowledge")}<//><${ErrorNote}
    error=${error} />`;
}

/** Most urgent alarm that is not acknowledged, or the group of equal ones that it belongs to; a cleared one only where no
 * condition holds. Its place is reserved: an alarm that comes or goes moves no button. */
function AlarmStrip() {
  if (route.value.page === "alarms") return null;
  const waiting = unacknowledged(openAlarms());
  const active = uncleared(waiting);
  const [equal] = groupAlarms(active.length > 0 ? active : waiting);
  return html`<section class="strip" aria-label=${t("page.nav_alarms")}>${equal
    ? html`<${StripAlarm} equal=${equal} others=${waiting.length - equal.length} />`
    : isLive.value && html`<p class="strip-calm"><${Icon} name="check" />${t("page.no_alarm_waits")}</p>`}</section>`;
}

function StripAlarm({ equal, others }) {
  const [alarm] = equal;
  const cleared = isCleared(alarm);
  const titled = (alarm.drive && drive(alarm.drive).value) || cleared; // the sentence says what no longer holds
  const text = titled ? alarmSubject(alarm) + localized(alarm.title) : localized(alarm.text);
  const group = t("page.alarm_group", { title: localized(alarm.title), n: equal.length });
  return html`<div class=${`banner alarm ${alarm.priority} ${cleared ? "cleared" : ""}`}><${PriorityMark}
    priority=${alarm.priority} />${cleared && html`<b class="state">${t("page.alarm_cleared")}</b>`}
    ${equal.length > 1 ? html`<a href=${href("alarms")}>${group} · ${groupSubject(equal)}</a>`
      : html`<a href=${alarm.drive ? href("drive", alarm.drive) : href("alarms")}>${text}</a>`}
    ${others > 0 && html`<a class="more" href=${href("alarms")}>${t("page.more_alarms", { n: others })}</a>`}
    ${may("operate") && html`<${Acknowledge} key=${equal.at(-1).id} alarms=${equal} />`}</div>`;
}

function takeoverKey({ owner, cause, time_ms }) {
  if (cause === "tab" || cause === "ended") return time_ms === null ? "page.control_ended_unseen" : `page.control_ended_${cause}`;
  if (owner === session.value?.user) return time_ms === null ? "page.taken_window_unseen" : "page.taken_window";
  return time_ms === null ? "page.taken_unseen" : "page.taken";
}

/** Takeovers of drives, those of one kind by one user in one sentence with the time of the last. The live region exists before its text, so that screen readers announce it. */
function Takeovers() {
  return html`<div class="takeovers" role="status">${groupTakeovers(takeovers.value).map((equal) => {
    const [one] = equal;
    const ids = [...new Set(equal.map((other) => other.drive))];
    const params = { owner: one.owner, name: listed(ids), time: clock(equal.at(-1).time_ms) };
    return html`<div class="banner high" key=${`${one.drive} ${one.time_ms}`}><${Icon} name="warning" />
      <a href=${ids.length > 1 ? href("fleet") : href("drive", one.drive)}>${t(takeoverKey(one), params)}</a>
      <${Button} onClick=${() => dismiss(equal)} data-do="read">${t("page.taken_read")}<//></div>`;
  })}</div>`;
}

/** Notice that the service shows to every user, until the user closes it or another one comes. */
function ServiceNotice() {
  const notice = topic("plant").value?.notice;
  const shown = notice && notice.en !== closedNotice.value;
  return html`<div role="status">${shown && html`<div class="banner info notice-line" data-text="notice">
    <span>${localized(notice)}</span><${Button} kind="quiet" onClick=${() => { closedNotice.value = notice.en; }} data-do="close-notice">
      ${t("page.close")}<//></div>`}</div>`;
}

/** Number of wrong passwords since the user's last login, until the user closes it. */
function FailedLogins() {
  const { failed_logins: n, session: id } = session.value;
  const shown = n > 0 && id !== closedLoginNotice.value;
  return html`<div role="status">${shown && html`<div class="banner high" data-text="failed-logins">
    <${Icon} name="warning" /><span>${t("page.failed_logins", { n })}</span>
    <${Button} onClick=${() => { closedLoginNotice.value = id; }}>${t("page.close")}<//></div>`}</div>`;
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
  return html`<div class="notices" ref=${box}><${ConnectionNotice} /><${ServiceNotice} /><${FailedLogins} /><${Unlock} />
    <${Takeovers} /><${ControlRequestNotices} /></div>`;
}

/** `children` is the page of the address. */
export function Shell({ children }) {
  const { page, id } = route.value;
  useEffect(() => { scrollTo(0, 0); }, [page, id]);
  return html`<a class="skip" href="#main"
    onClick=${(event) => { event.preventDefault(); document.getElementById("main").focus(); }}>${t("page.skip")}</a>
    <${PageHeader} /><${Notices} /><${AlarmStrip} />
    <main id="main" tabindex="-1" class=${connection.value === "live" ? "" : "stale"}><${PlantNotice} />${children}</main>
      <${StopBar} />`;
}
