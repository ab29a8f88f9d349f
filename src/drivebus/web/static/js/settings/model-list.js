// Models that drivebus knows: a list that is filtered while typing.
import { html, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { href } from "../router.js";
import { ErrorNote, Field, Loading, Table, useLoaded } from "../ui.js";

/** All words of the search in name, maker, title or family; Chinese and English texts both count. */
export function matching(models, search) {
  const words = search.toLowerCase().split(/\s+/).filter(Boolean);
  return models.filter(({ model, maker, title, family }) => {
    const text = [model, family, maker.en, maker.zh, title.en, title.zh].join(" ").toLowerCase();
    return words.every((word) => text.includes(word));
  });
}

const lacks = ({ capabilities }) => ["reverse", "jog", "status", "write"].filter((name) => !capabilities.includes(name));

export function ModelList() {
  const [found, error] = useLoaded(() => api.get("/models"), []);
  const [search, setSearch] = useState("");
  const rows = useMemo(() => (found ? matching(found.models, search) : []), [found, search]);
  if (!found) return error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`;
  return html`<section class="panel stack"><p class="soft">${t("page.models_help")}</p>
    <${Field} label=${t("page.search")} help=${t("page.models_found", { n: rows.length, total: found.models.length })}>
      <input type="search" value=${search} spellcheck="false"
        onInput=${(event) => setSearch(event.currentTarget.value)} /><//>
    <${Table} caption=${t("page.models")} rows=${rows} keyOf=${(one) => one.model} empty=${t("page.models_none")}
      columns=${[
        [t("page.maker"), (one) => localized(one.maker)],
        [t("page.model"), (one) => html`<a href=${href("models", one.model)}>${localized(one.title)}</a>
          <br /><code>${one.model}</code>`, "wide"],
        [t("page.grade"), (one) => t(`page.grade_${one.grade}`)],
        [t("page.encodings"), (one) => one.encodings.join(t("language.between_items"))],
        [t("page.serial_default"), (one) => `${one.serial.baud} ${one.serial.format}`],
        [t("page.can_not"), (one) => lacks(one).map((name) => t(`page.can_${name}`)).join(t("language.between_items")) || "–"],
      ]} /></section>`;
}
