// Part of the page whose script error leaves the rest of the page, and with it the stops, at work.
import { Component, html } from "./lib.js";
import { t } from "./i18n.js";
import { Button, Notice } from "./ui.js";

/** Shows an error in place of its children, which would stay on the screen as they were before it. `title` names the part
 * where that is not clear from its place. */
export class ErrorBoundary extends Component {
  componentDidCatch(error) {
    console.error(error);
    this.setState({ error });
  }

  render({ title, children }, { error }) {
    if (!error) return children;
    return html`<div data-text="broken"><${Notice} kind="bad" live title=${title}><p>${t("page.broken", { why: String(error.message ?? error) })}</p>
      <div class="row"><${Button} onClick=${() => this.setState({ error: null })} data-do="draw-again">${t("page.try_again")}<//>
        <${Button} onClick=${() => location.reload()}>${t("page.reload_page")}<//></div><//></div>`;
  }
}
