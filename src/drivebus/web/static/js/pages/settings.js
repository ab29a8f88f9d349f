// Settings: how the page looks, one's own password and tokens, users, and the plant's configuration.
import { html } from "../lib.js";
import { LANGUAGES, chooseLanguage, language, t } from "../i18n.js";
import { moment } from "../format.js";
import { THEMES, chooseTheme, themeChoice } from "../theme.js";
import { replaceQuery } from "../router.js";
import { may, session } from "../session.js";
import { topic } from "../store.js";
import { styled } from "../style.js";
import { Choice, Tabs } from "../ui.js";
import { Configuration } from "../parts/configuration.js";
import { Password } from "../parts/password.js";
import { Tokens } from "../parts/tokens.js";
import { Users } from "../parts/users.js";

await styled("pages");

export function Page({ query }) {
  const tabs = [
    ["me", t("plantpage.me"), () => html`<${Me} />`],
    ["tokens", t("plantpage.tokens"), () => html`<${Tokens} />`],
    ...(may("administer") ? [["users", t("plantpage.users"), () => html`<${Users} />`]] : []),
    ...(may("configure") ? [["configuration", t("plantpage.configuration"), () => html`<${Configuration} />`]] : []),
    ["about", t("plantpage.about"), () => html`<${About} />`],
  ];
  return html`<h1>${t("page.way_settings")}</h1>
    <${Tabs} label=${t("page.way_settings")} tabs=${tabs} value=${query.tab ?? "me"}
      onChange=${(tab) => replaceQuery({ tab })} />`;
}

function Me() {
  const { user, role, rights } = session.value;
  return html`<div class="stack"><section class="panel stack"><h2>${t("plantpage.looks")}</h2>
      <div class="row"><span>${t("plantpage.language")}</span><${Choice} label=${t("plantpage.language")}
        value=${language.value}
        options=${Object.entries(LANGUAGES)} onChange=${chooseLanguage} /></div>
      <div class="row"><span>${t("plantpage.theme")}</span><${Choice} label=${t("plantpage.theme")}
        value=${themeChoice.value}
        options=${THEMES.map((name) => [name, t(`page.theme_${name}`)])} onChange=${chooseTheme} /></div></section>
    <section class="panel stack"><h2>${user}</h2><dl class="facts">
      ${role && html`<dt>${t("plantpage.role")}</dt><dd>${t(`plantpage.role_${role}`)}</dd>`}
      <dt>${t("plantpage.rights")}</dt>
        <dd>${rights.map((right) => t(`plantpage.right_${right}`)).join(t("page.comma"))}</dd></dl></section>
    <${Password} /></div>`;
}

function About() {
  const plant = topic("plant").value ?? {};
  const facts = [
    ["plant", plant.id], ["version", plant.version], ["started", plant.started_ms && moment(plant.started_ms)],
  ];
  return html`<section class="panel stack"><h2>drivebus</h2><dl class="facts">
    ${facts.filter(([, value]) => value).map(([name, value]) => html`<dt
      key=${name}>${t(`plantpage.about_${name}`)}</dt><dd>${value}</dd>`)}</dl>
    <p>${t("plantpage.about_safety")}</p></section>`;
}
