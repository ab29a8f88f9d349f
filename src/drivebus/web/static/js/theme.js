// Light, dark, or as the system has it. The resolved theme stands on <html data-theme>; charts follow `theme`.
import { computed, effect, signal } from "./lib.js";
import { loadPreference, onPreferenceOfOtherTab, savePreference } from "./preferences.js";

export const THEMES = ["auto", "light", "dark"];
const query = matchMedia("(prefers-color-scheme: dark)");
const systemDark = signal(query.matches);
query.addEventListener("change", (event) => { systemDark.value = event.matches; });

export const themeChoice = signal(THEMES.includes(loadPreference("theme")) ? loadPreference("theme") : "auto");
/** "light" or "dark". */
export const theme = computed(() => {
  if (themeChoice.value !== "auto") return themeChoice.value;
  return systemDark.value ? "dark" : "light";
});

onPreferenceOfOtherTab("theme", (name) => { if (THEMES.includes(name)) themeChoice.value = name; });

effect(() => { document.documentElement.dataset.theme = theme.value; });

export function chooseTheme(name) {
  themeChoice.value = name;
  savePreference("theme", name);
}
