// Texts of the page: the server's catalogue of the chosen language.
import { signal } from "./lib.js";
import { loadPreference, onPreferenceOfOtherTab, savePreference } from "./preferences.js";

export const LANGUAGES = { en: "English", zh: "中文" };

/** Language as HTML names it. */
export const languageTag = (name) => (name === "zh" ? "zh-CN" : "en");

const browserLanguage = (navigator.language || "en").toLowerCase().startsWith("zh") ? "zh" : "en";
const storedLanguage = loadPreference("language");

/** "en" or "zh". */
export const language = signal(storedLanguage in LANGUAGES ? storedLanguage : browserLanguage);
const sentences = signal({});
let unspaced = null; // letters of the language between two of which no space stands; null for English

async function fetchCatalogue(name) {
  const answer = await fetch(`/i18n/${name}.json`);
  if (!answer.ok) throw new Error(`/i18n/${name}.json ${answer.status}`);
  return answer.json();
}

/** Language requested last: the catalogue of an earlier request may arrive after its own. */
let requested = null;

/** Load the catalogue of a language and change every text on the page at once. */
export async function loadLanguage(name) {
  requested = name;
  const found = await fetchCatalogue(name);
  if (requested !== name) return;
  unspaced = found["language.unspaced_letters"] ? new RegExp(found["language.unspaced_letters"]) : null;
  sentences.value = found;
  language.value = name;
  document.documentElement.lang = languageTag(name);
}

/** Change the language and store the choice for the next visit. */
export async function chooseLanguage(name) {
  await loadLanguage(name);
  if (requested === name) savePreference("language", name);
}

onPreferenceOfOtherTab("language", (name) => { if (name in LANGUAGES) loadLanguage(name); });

export const hasKey = (key) => key in sentences.value;

/** Text of `key` with its `{placeholders}` filled; the key itself where the catalogue has none. */
export function t(key, params = {}) {
  const sentence = sentences.value[key];
  if (sentence === undefined) return key;
  return sentence.replace(/( ?)\{(\w+)(?::[^}]*)?\}( ?)/g, (place, before, name, after, at) => {
    if (!(name in params)) return place;
    const value = paramText(params[name]);
    const rest = sentence.slice(at + place.length);
    const following = params[/^\{(\w+)/.exec(rest)?.[1]];
    const next = following === undefined ? rest[0] : paramText(following)[0];
    return gap(before, sentence[at - 1], value[0]) + isolated(value) + gap(after, value.at(-1), next);
  });
}

/** Letters of the scripts that are written from right to left, such as Hebrew and Arabic. */
const RIGHT_TO_LEFT = /[\u0590-\u08FF\uFB1D-\uFDFF\uFE70-\uFEFC]/;

/** A name that is written from right to left, isolated from the words, numbers and signs around it. */
export const isolated = (name) => (RIGHT_TO_LEFT.test(name) ? `\u2068${name}\u2069` : name);

/** The space between two letters: Chinese has one beside Latin letters and digits only. */
const gap = (space, left = "", right = "") => (isUnspaced(left, right) ? "" : space);

const isUnspaced = (left, right) => unspaced !== null && unspaced.test(left) && unspaced.test(right);

/** Two pieces of a sentence as one, without a space between two letters that have none between them. */
function joined(left, right) {
  const hasNoSpace = isUnspaced(left.trimEnd().at(-1) ?? "", right.trimStart()[0] ?? "");
  return hasNoSpace ? left.trimEnd() + right.trimStart() : left + right;
}

/** Place of a whole name or number in a sentence, -1 without one: the 2 of "c320" and "F0.2" is none. */
export function placeOf(sentence, word) {
  for (let at = sentence.indexOf(word); at >= 0; at = sentence.indexOf(word, at + 1)) {
    if (!/\w[.-]?$/.test(sentence.slice(0, at)) && !/^[.-]?\w/.test(sentence.slice(at + word.length))) return at;
  }
  return -1;
}

/** `sentence` with `value` in place of the first whole `old` in it. */
export function replaced(sentence, old, value) {
  const at = placeOf(sentence, old);
  return at < 0 ? sentence : joined(joined(sentence.slice(0, at), value), sentence.slice(at + old.length));
}

const paramText = (value) => (value !== null && typeof value === "object" && "en" in value ? localized(value) : String(value));

/** A text that came in both languages: `{"en": …, "zh": …}`. */
export function localized(text) {
  if (text === null || text === undefined) return "";
  return typeof text === "string" ? text : text[language.value] || text.en || "";
}

/** A title in both languages, else the id of the thing. */
export const titleOf = (thing) => localized(thing.title) || thing.id;

/** Locale of the language for Intl; English dates have the day first and 24 hours. */
export const locale = () => (language.value === "zh" ? "zh-CN" : "en-GB");
