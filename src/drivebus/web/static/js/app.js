// Entry point: load language and session, connect, render the page of the address.
import { computed, effect, html, render, signal, useEffect, useState } from "./lib.js";
import { hasKey, language, loadLanguage, t, titleOf } from "./i18n.js";
import "./theme.js";
import { loadSession, loggedIn, loginOnce, session, watchActivity } from "./session.js";
import { openAlarms, unacknowledged } from "./alarms/alarm-list.js";
import { startAlarmAnnouncement } from "./alarms/alarm-announcement.js";
import { startAlarmSound } from "./alarms/alarm-sound.js";
import { isLive, startLiveConnection } from "./live.js";
import { startLeaseRenewal } from "./control/leases.js";
import { keepFocus } from "./focus.js";
import { loadHistoryTags } from "./history-tags.js";
import { go, href, route } from "./router.js";
import { drive, topic } from "./store.js";
import { watchForeignStops } from "./control/foreign-stops.js";
import { watchTakeovers } from "./control/takeovers.js";
import { Shell } from "./shell.js";
import { ErrorNote, Loading, Notice } from "./ui.js";
import { Login } from "./pages/login.js";

/** Names of the modules in pages/; each exports Page({id, query}) and is loaded when first opened. */
const PAGES = new Set(["fleet", "drive", "buses", "alarms", "history", "audit", "settings", "incidents", "models"]);
const loaded = new Map();
const loadProblem = signal(null);

const loadPage = (page) => import(`./pages/${page}.js`).then((found) => { loaded.set(page, found.Page); });

function CurrentPage() {
  const { page, id, query } = route.value;
  const [, redraw] = useState(0);
  const exists = PAGES.has(page) && (page !== "drive" || id !== null);
  const Page = loaded.get(page);
  useEffect(() => {
    if (!exists || Page) return;
    loadPage(page).then(
      () => redraw((n) => n + 1),
      () => { loadProblem.value = { wasOffline: !isLive.peek() }; },
    );
  }, [page]);
  // A browser caches the failure to fetch a module; only a reload of the page retries it.
  const canRetry = Boolean(loadProblem.value?.wasOffline) && isLive.value;
  useEffect(() => { if (canRetry) location.reload(); }, [canRetry]);
  if (!exists) return html`<h1 class="sr">drivebus</h1><${Notice} kind="warning">${t("page.no_such_page")} <a href=${href("fleet")}>
    ${t("page.nav_fleet")}</a><//>`;
  if (!Page && loadProblem.value) return html`<${Notice} kind="bad" live>${t("page.not_loaded")}<//>`;
  if (!Page) return html`<${Loading} />`;
  return html`<${Page} key=${`${page}/${id}`} id=${id} query=${query} />`;
}

const startError = signal(null);

function App() {
  if (session.value === null) return startError.value ? html`<${ErrorNote} error=${startError.value} />` : null;
  if (!loggedIn.value) return html`<${Login} error=${startError.value} />`;
  return html`<${Shell}><${CurrentPage} /><//>`;
}

/** Log in with the one-time code of `#login=CODE` and remove it from the address at once. */
async function loginWithCode() {
  const code = /^#login=(.+)$/.exec(location.hash)?.[1];
  if (!code) return;
  history.replaceState(null, "", "#/fleet");
  route.value = { page: "fleet", id: null, query: {} };
  await loginOnce(decodeURIComponent(code));
}

const tryLoginWithCode = () => loginWithCode().catch((error) => { startError.value = error; go("fleet"); });

async function connectToServer() {
  for (;;) {
    try {
      await loadSession();
      startError.value = null;
      return;
    } catch (error) {
      startError.value = error;
      await new Promise((resolve) => { setTimeout(resolve, 1500); });
    }
  }
}

/** Load the names of the signals after each login, once the drives are shown. */
function loadSignalNames() {
  const isReady = computed(() => loggedIn.value && isLive.value);
  effect(() => { if (isReady.value) loadHistoryTags(); });
}

effect(() => { if (loggedIn.value) startError.value = null; });

/** Name of a page for the tab of the browser: of a drive its title; null where there is no such page. */
function nameOfPage({ page, id }) {
  const view = page === "drive" ? drive(id).value : null;
  if (view) return titleOf(view);
  const key = page === "models" ? "page.models" : `page.nav_${page}`;
  return hasKey(key) ? t(key) : null;
}

effect(() => {
  const plant = topic("plant").value;
  const name = plant ? titleOf(plant) : "drivebus";
  const waiting = loggedIn.value ? unacknowledged(openAlarms()).length : 0;
  const count = waiting > 0 ? `(${waiting}) ` : "";
  const page = loggedIn.value ? nameOfPage(route.value) : null;
  document.title = count + (page ? `${page} · ${name}` : name);
});

// The first page, the texts and the session are requested at the same time.
if (PAGES.has(route.peek().page)) loadPage(route.peek().page).catch(() => null);
const connected = connectToServer();
await loadLanguage(language.peek());
render(html`<${App} />`, document.getElementById("page"));
await connected;
await tryLoginWithCode();
addEventListener("hashchange", tryLoginWithCode); // an address with a code may be pasted into the open page
startLiveConnection();
watchActivity();
loadSignalNames();
startLeaseRenewal();
watchForeignStops();
watchTakeovers();
startAlarmSound();
startAlarmAnnouncement();
keepFocus();
