// Sound while a critical or high alarm waits for its acknowledgement, in one tab of a browser. Each browser can silence it.
import { computed, effect, signal } from "../lib.js";
import { urgentAlarms } from "./alarm-list.js";
import { isLive } from "../live.js";
import { loadPreference, onPreferenceOfOtherTab, savePreference } from "../preferences.js";
import { loggedIn } from "../session.js";
import { nowMs } from "../store.js";

const REPEAT_MS = 10_000;
/** From the beginning of a sound to that of the next one: alarms that follow each other closely have one sound, and a pause. */
const MIN_INTERVAL_MS = 2000;
const TONES_HZ = [880, 660];
const TONE_S = 0.25;
/** Held by the tab that sounds. */
const LOCK = "drivebus.alarm-sound";

const isChosen = () => loadPreference("sound", true) === true;

export const isSoundOn = signal(isChosen());
const hasBeenUsed = () => navigator.userActivation?.hasBeenActive !== false;

/** Whether this browser lets the page sound: only after the user's first click or key on it, also after a reload. */
export const isSoundPermitted = signal(hasBeenUsed());
let audio = null;
let timer = null;
/** Earliest time of the next sound (`nowMs`). */
let nextAt = 0;

/** Turn the sound off or on; the click that lets the browser sound leaves it on. */
export function toggleSound() {
  if (isSoundOn.value && !isSoundPermitted.value) return;
  isSoundOn.value = !isSoundOn.value;
  savePreference("sound", isSoundOn.value);
}

/** Sound both tones, where the browser permits it: before, it only warns. */
export function play() {
  const isPermitted = hasBeenUsed();
  isSoundPermitted.value = isPermitted;
  if (!isPermitted) return;
  nextAt = nowMs() + MIN_INTERVAL_MS;
  audio ??= new AudioContext();
  audio.resume();
  TONES_HZ.forEach((hertz, n) => {
    const [tone, volume] = [new OscillatorNode(audio, { frequency: hertz }), new GainNode(audio, { gain: 0.2 })];
    tone.connect(volume).connect(audio.destination);
    tone.start(audio.currentTime + n * TONE_S);
    tone.stop(audio.currentTime + (n + 1) * TONE_S);
  });
}

/** Sound now, or where another sound began just before as soon as that is over, and then every ten seconds. */
function playRepeatedly() {
  clearTimeout(timer);
  const wait_ms = nextAt - nowMs();
  if (wait_ms <= 0) play();
  timer = setTimeout(playRepeatedly, wait_ms > 0 ? wait_ms : REPEAT_MS);
}

/** Whether this tab sounds; each one does where the browser has no locks, as without HTTPS. */
const isSoundingTab = signal(!navigator.locks);

/**
 * Hold the lock while this tab could sound, so that one of several tabs does: the visible one that was shown or
 * first clicked last. A hidden tab may be suspended, as on a tablet: it keeps the lock only until a visible one takes it. A
 * tab whose connection is lost leaves it to one that is waiting for it.
 */
function shareSound() {
  if (!navigator.locks) return;
  const canSound = computed(() => loggedIn.value && isSoundOn.value && isSoundPermitted.value);
  const turn = signal(0);
  const tabs = new BroadcastChannel(LOCK);
  tabs.onmessage = () => { if (!document.hidden && !isSoundingTab.peek()) turn.value += 1; };
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) tabs.postMessage("hidden");
    else turn.value += 1;
  });
  effect(() => {
    turn.value;
    if (!canSound.value) return undefined;
    const waiting = new AbortController();
    const { signal: ended } = waiting;
    const hold = () => (ended.aborted ? null : new Promise((resolve) => {
      ended.addEventListener("abort", resolve);
      isSoundingTab.value = true;
    }));
    const request = (options) => navigator.locks.request(LOCK, options, hold).catch(({ name }) => {
      if (ended.aborted || name !== "AbortError") return;
      isSoundingTab.value = false; // another tab has taken the lock
      request({ signal: ended });
    });
    request(isLive.value && !document.hidden ? { steal: true } : { signal: ended });
    return () => {
      isSoundingTab.value = false;
      waiting.abort();
    };
  });
}

/**
 * Sound for a new urgent alarm and every ten seconds until all are acknowledged or shelved. The choice of one tab holds in
 * every tab of the browser, as the button says.
 */
export function startAlarmSound() {
  let known = new Set();
  onPreferenceOfOtherTab("sound", () => { isSoundOn.value = isChosen(); });
  for (const name of ["click", "keydown"]) addEventListener(name, () => { isSoundPermitted.value = hasBeenUsed(); });
  shareSound();
  effect(() => {
    if (urgentAlarms().length > 0) isSoundPermitted.value = hasBeenUsed();
    const urgent = isSoundOn.value && isSoundingTab.value ? urgentAlarms() : [];
    const isNew = urgent.some((alarm) => !known.has(alarm.id));
    known = new Set(urgent.map((alarm) => alarm.id));
    if (isNew) playRepeatedly();
    else if (urgent.length === 0) clearTimeout(timer);
  });
}
