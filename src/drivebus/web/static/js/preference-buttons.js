// Buttons of the language, the theme and the sound of alarms.
import { html } from "./lib.js";
import { isSoundOn, isSoundPermitted, toggleSound } from "./alarms/alarm-sound.js";
import { LANGUAGES, chooseLanguage, language, languageTag, t } from "./i18n.js";
import { session } from "./session.js";
import { THEMES, chooseTheme, themeChoice } from "./theme.js";
import { Button } from "./ui.js";

export function PreferenceButtons() {
  const other = language.value === "zh" ? "en" : "zh";
  const next = THEMES[(THEMES.indexOf(themeChoice.value) + 1) % THEMES.length];
  return html`<${Button} kind="quiet" lang=${languageTag(other)} onClick=${() => chooseLanguage(other)}>
    ${LANGUAGES[other]}<//>
    <${Button} kind="quiet" icon="sun" onClick=${() => chooseTheme(next)}
      aria-label=${t("page.theme_is", { now: t(`page.theme_${themeChoice.value}`), next: t(`page.theme_${next}`) })}>
      ${t(`page.theme_${themeChoice.value}`)}<//>
    ${session.value.user && html`<${SoundButton} />`}`;
}

function SoundButton() {
  const how = !isSoundOn.value ? "off" : isSoundPermitted.value ? "on" : "waits";
  return html`<${Button} kind="quiet" icon=${how === "on" ? "sound" : "silenced"} data-do="sound"
    aria-pressed=${isSoundOn.value ? "true" : "false"} aria-label=${t("page.alarm_sound")} title=${t(`page.alarm_sound_${how}`)}
    onClick=${toggleSound} />`;
}
