// Every sentence that the page shows comes from here: the server's catalogue of the chosen language.
import { signal } from "./lib.js";
import { recall, remember } from "./memory.js";

export const LANGUAGES = { en: "English", zh: "中文" };

const browser = (navigator.language || "en").toLowerCase().startsWith("zh") ? "zh" : "en";
const chosen = recall("language");

/** "en" or "zh". */
export const language = signal(chosen in LANGUAGES ? chosen : browser);
const sentences = signal({});

async function fetchCatalogue(name) {
  const answer = await fetch(`/i18n/${name}.json`);
  if (!answer.ok) throw new Error(`/i18n/${name}.json ${answer.status}`);
  return answer.json();
}

/** Loads the catalogue and changes every sentence on the page at once. */
export async function loadLanguage(name) {
  sentences.value = await fetchCatalogue(name);
  language.value = name;
  document.documentElement.lang = name === "zh" ? "zh-CN" : "en";
}

/** The user's choice, kept for the next visit. */
export async function chooseLanguage(name) {
  await loadLanguage(name);
  remember("language", name);
}

export const known = (key) => key in sentences.value;

/** The sentence for `key` with its `{places}` filled; the key itself where there is none. */
export function t(key, params = {}) {
  const sentence = sentences.value[key];
  if (sentence === undefined) return key;
  return sentence.replace(/\{(\w+)(?::[^}]*)?\}/g, (place, name) => (name in params ? shown(params[name]) : place));
}

const shown = (value) => (value !== null && typeof value === "object" && "en" in value ? both(value) : String(value));

/** A text that came in both languages: `{"en": …, "zh": …}`. */
export function both(text) {
  if (text === null || text === undefined) return "";
  return typeof text === "string" ? text : text[language.value] || text.en || "";
}

/** A title in both languages, else the id of the thing. */
export const titled = (thing) => both(thing.title) || thing.id;
