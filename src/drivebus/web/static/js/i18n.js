// Every sentence that the page shows comes from here: the server's catalogue of the chosen language.
import { signal } from "./lib.js";
import { loadPreference, savePreference } from "./preferences.js";

export const LANGUAGES = { en: "English", zh: "中文" };

const browserLanguage = (navigator.language || "en").toLowerCase().startsWith("zh") ? "zh" : "en";
const storedLanguage = loadPreference("language");

/** "en" or "zh". */
export const language = signal(storedLanguage in LANGUAGES ? storedLanguage : browserLanguage);
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
  savePreference("language", name);
}

export const hasKey = (key) => key in sentences.value;

/** The sentence for `key` with its `{places}` filled; the key itself where there is none. */
export function t(key, params = {}) {
  const sentence = sentences.value[key];
  if (sentence === undefined) return key;
  return sentence.replace(/\{(\w+)(?::[^}]*)?\}/g, (place, name) => (name in params ? paramText(params[name]) : place));
}

const paramText = (value) => (value !== null && typeof value === "object" && "en" in value ? localized(value) : String(value));

/** A text that came in both languages: `{"en": …, "zh": …}`. */
export function localized(text) {
  if (text === null || text === undefined) return "";
  return typeof text === "string" ? text : text[language.value] || text.en || "";
}

/** A title in both languages, else the id of the thing. */
export const titleOf = (thing) => localized(thing.title) || thing.id;
