// Paged list: newest entries first, older ones on demand.
import { html, useEffect, useRef, useState } from "./lib.js";
import { api } from "./api.js";
import { t } from "./i18n.js";
import { Button, ErrorNote, Loading, useReloadOnReconnect } from "./ui.js";

const START = { items: [], next: null, busy: true, error: null };

/** Load a list page by page; another `query` starts over. Returns `{items, next, busy, error, more, reload}`. */
export function usePaged(path, query) {
  const [state, setState] = useState(START);
  const request = useRef(null);
  const key = JSON.stringify([path, query]);

  const load = async (cursor, kept) => {
    request.current?.abort();
    const current = request.current = new AbortController();
    setState((old) => ({ ...old, items: kept, busy: true, error: null }));
    try {
      const found = await api.get(path, { ...query, cursor }, { signal: current.signal });
      if (!current.signal.aborted) setState({ items: [...kept, ...found.items], next: found.next, busy: false,
        error: null });
    } catch (error) {
      if (!current.signal.aborted) setState((old) => ({ ...old, busy: false, error }));
    }
  };
  useEffect(() => {
    load(null, []);
    return () => request.current?.abort();
  }, [key]);
  const reload = () => load(null, []);
  useReloadOnReconnect(state.error, reload);
  return { ...state, more: () => load(state.next, state.items), reload };
}

/** End of a paged list: error, progress, or the button for more. */
export function PagedEnd({ list }) {
  if (list.error) return html`<${ErrorNote} error=${list.error} /><${Button}
    onClick=${list.reload}>${t("page.try_again")}<//>`;
  if (list.busy) return html`<${Loading} />`;
  if (list.next === null) return html`<p class="help">${t("page.list_end", { n: list.items.length })}</p>`;
  return html`<${Button} onClick=${list.more}>${t("page.show_more")}<//>`;
}
