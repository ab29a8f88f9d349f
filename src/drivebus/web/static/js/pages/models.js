// Models: the list, and the profile of one model whether or not the plant has such a drive.
import { html } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { href, replaceQuery } from "../router.js";
import { loadStylesheet } from "../stylesheet.js";
import { ErrorNote, Loading, useLoaded } from "../ui.js";
import { Tabs } from "../tabs.js";
import { KnownFaults } from "../drive/faults.js";
import { ModelParameters } from "../drive/parameters.js";
import { ModelProfile } from "../drive/profile.js";
import { ModelList } from "../settings/model-list.js";

await loadStylesheet("pages");

export function Page({ id, query }) {
  return id === null ? html`<h1>${t("page.models")}</h1><${ModelList} />`
    : html`<${Model} key=${id} id=${id} query=${query} />`;
}

function Model({ id, query }) {
  const [profile, error] = useLoaded(() => api.get(`/models/${encodeURIComponent(id)}`), [id]);
  const back = html`<p><a href=${href("models")}>← ${t("page.models_back")}</a></p>`;
  if (!profile) return html`${back}<h1>${id}</h1>${error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`}`;
  const tabs = [
    ["profile", t("page.tab_profile"), () => html`<${ModelProfile} profile=${profile} />`],
    ["parameters", t("page.tab_parameters"), () => html`<${ModelParameters} profile=${profile} />`],
    ["faults", t("page.tab_faults"), () => html`<${KnownFaults} profile=${profile} />`],
  ];
  return html`${back}<h1>${localized(profile.maker)} ${localized(profile.title)}</h1><section class="panel">
    <h2 class="sr">${t("page.details")}</h2><${Tabs} label=${t("page.details")} tabs=${tabs} value=${query.tab ?? "profile"}
      onChange=${(tab) => replaceQuery({ tab })} /></section>`;
}
