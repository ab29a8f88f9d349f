// Models that drivebus knows: a list that is filtered while typing.
import { html, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { NO_VALUE } from "../format.js";
import { href } from "../router.js";
import { SearchField, hasWords } from "../search.js";
import { ErrorNote, Loading, Table, useLoaded } from "../ui.js";

/** All words of the search in name, maker, title or family; Chinese and English texts both count. */
export const matching = (models, search) => models.filter(({ model, maker, title, family }) => (
  hasWords([model, family, maker.en, maker.zh, title.en, title.zh].join(" "), search)));

const lacks = ({ capabilities }) => ["reverse", "jog", "status", "write"].filter((name) => !capabilities.includes(name));

export function ModelList() {
  const [found, error] = useLoaded(() => api.get("/models"), []);
  const [search, setSearch] = useState("");
  const rows = useMemo(() => (found ? matching(found.models, search) : []), [found, search]);
  if (!found) return error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`;
  return html`<section class="panel stack"><p class="soft">${t("page.models_help")}</p>
    <${SearchField} help=${t("page.models_found", { n: rows.length, total: found.models.length })} value=${search}
      onChange=${setSearch} />
    <${Table} stacks caption=${t("page.models")} rows=${rows} keyOf=${(model) => model.model} empty=${t("page.models_none")}
      columns=${[
        [t("page.maker"), (model) => localized(model.maker)],
        [t("page.model"), (model) => html`<a href=${href("models", model.model)}>${localized(model.title)}</a>
          <br /><code>${model.model}</code>`, "wide"],
        [t("page.grade"), (model) => t(`page.grade_${model.grade}`)],
        [t("page.encodings"), (model) => model.encodings.join(t("language.between_items"))],
        [t("page.serial_default"), (model) => `${model.serial.baud} ${model.serial.format}`],
        [t("page.can_not"), (model) => lacks(model).map((name) => t(`page.can_${name}`)).join(t("language.between_items")) || NO_VALUE],
      ]} /></section>`;
}
