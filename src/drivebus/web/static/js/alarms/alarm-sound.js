// Sound while a critical or high alarm waits for its acknowledgement. Each browser can silence it.
import { effect, signal } from "../lib.js";
import { urgentAlarms } from "./alarm-list.js";
import { loadPreference, savePreference } from "../preferences.js";

const REPEAT_MS = 10_000;
const TONES_HZ = [880, 660];
const TONE_S = 0.25;

export const isSoundOn = signal(loadPreference("sound", true) === true);
let audio = null;
let timer = null;

export function chooseSound(on) {
  isSoundOn.value = on;
  savePreference("sound", on);
}

/** Sound both tones. A browser lets a page sound only after the user's first click or key on it, and warns before. */
export function play() {
  if (navigator.userActivation?.hasBeenActive === false) return;
  audio ??= new AudioContext();
  audio.resume();
  TONES_HZ.forEach((hertz, n) => {
    const [tone, volume] = [new OscillatorNode(audio, { frequency: hertz }), new GainNode(audio, { gain: 0.2 })];
    tone.connect(volume).connect(audio.destination);
    tone.start(audio.currentTime + n * TONE_S);
    tone.stop(audio.currentTime + (n + 1) * TONE_S);
  });
}

/** Sound at once for a new urgent alarm and every ten seconds until all are acknowledged or shelved. */
export function startAlarmSound() {
  let known = new Set();
  effect(() => {
    const urgent = isSoundOn.value ? urgentAlarms() : [];
    const isNew = urgent.some((alarm) => !known.has(alarm.id));
    known = new Set(urgent.map((alarm) => alarm.id));
    if (urgent.length > 0 && !isNew && timer) return;
    clearInterval(timer);
    timer = urgent.length > 0 ? setInterval(play, REPEAT_MS) : null;
    if (isNew) play();
  });
}
