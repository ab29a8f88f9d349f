// Settings: language and theme, own password and tokens, users, and the plant's configuration.
import { html } from "../lib.js";
import { LANGUAGES, chooseLanguage, language, languageTag, t, titleOf } from "../i18n.js";
import { moment } from "../format.js";
import { THEMES, chooseTheme, themeChoice } from "../theme.js";
import { replaceQuery } from "../router.js";
import { may, session } from "../session.js";
import { topic } from "../store.js";
import { loadStylesheet } from "../stylesheet.js";
import { Choice } from "../ui.js";
import { Tabs } from "../tabs.js";
import { Configuration } from "../settings/configuration.js";
import { ModelList } from "../settings/model-list.js";
import { OwnSessions } from "../settings/own-sessions.js";
import { Password } from "../settings/password.js";
import { Tokens } from "../settings/tokens.js";
import { Users } from "../settings/users.js";

await loadStylesheet("pages");

export function Page({ query }) {
  const tabs = [
    ["me", t("page.me"), () => html`<${OwnAccount} />`],
    ["tokens", t("page.tokens"), () => html`<${Tokens} />`],
    ...(may("administer") ? [["users", t("page.users"), () => html`<${Users} />`]] : []),
    ...(may("configure") ? [["configuration", t("page.configuration"), () => html`<${Configuration} />`]] : []),
    ["models", t("page.models"), () => html`<${ModelList} />`],
    ["about", t("page.about"), () => html`<${About} />`],
  ];
  return html`<h1>${t("page.nav_settings")}</h1>
    <${Tabs} label=${t("page.nav_settings")} tabs=${tabs} value=${query.tab ?? "me"}
      onChange=${(tab) => replaceQuery({ tab })} />`;
}

function OwnAccount() {
  const { user, role, rights } = session.value;
  return html`<div class="stack"><section class="panel stack"><h2>${t("page.looks")}</h2>
      <div class="row"><span>${t("page.language")}</span><${Choice} label=${t("page.language")} value=${language.value}
        options=${Object.entries(LANGUAGES).map(([name, text]) => [name, html`<span lang=${languageTag(name)}>${text}</span>`])} onChange=${chooseLanguage} /></div>
      <div class="row"><span>${t("page.theme")}</span><${Choice} label=${t("page.theme")} value=${themeChoice.value}
        options=${THEMES.map((name) => [name, t(`page.theme_${name}`)])} onChange=${chooseTheme} /></div></section>
    <section class="panel stack"><h2>${user}</h2><dl class="facts">
      ${role && html`<dt>${t("page.role")}</dt><dd>${t(`page.role_${role}`)}</dd>`}
      <dt>${t("page.rights")}</dt>
        <dd>${rights.map((right) => t(`page.right_${right}`)).join(t("language.between_items"))}</dd></dl></section>
    <${Password} /><${OwnSessions} /></div>`;
}

function gatewayState({ id, running, exit_code: code }) {
  return t(`page.about_gateway_${running ? "running" : "restarting"}`, { gateway: id, code: code ?? "-" });
}

function About() {
  const plant = topic("plant").value ?? {};
  const facts = [
    ["plant", plant.id && titleOf(plant)], ["version", plant.version], ["started", plant.started_ms && moment(plant.started_ms)],
    ["clock", typeof plant.clock_synchronized === "boolean" && t(`page.about_clock_${plant.clock_synchronized}`)],
    ["gateways", plant.gateways?.map(gatewayState).join(t("language.between_items"))],
  ];
  return html`<section class="panel stack"><h2>drivebus</h2><dl class="facts">
    ${facts.filter(([, value]) => value).map(([name, value]) => html`<dt
      key=${name}>${t(`page.about_${name}`)}</dt><dd>${value}</dd>`)}</dl>
    <p>${t("page.about_safety")}</p></section>`;
}
