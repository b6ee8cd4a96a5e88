/** The ways through a listing that comes page by page. */

import { html } from "../lib/html.js";
import { href } from "../lib/route.js";

/**
 * Links to the first page and to the next one, by the cursor in the address.
 * path, query: of the present address. next: the listing's. first, more: what the links say.
 */
export function Pages({ path, query, next, first, more, name }) {
  const at = (cursor) => {
    const parts = new URLSearchParams(query);
    parts.delete("cursor");
    if (cursor) parts.set("cursor", cursor);
    return href(path, parts);
  };
  return html`<nav class="pages" aria-label=${name}>
    ${query.get("cursor") && html`<a href=${at(null)}>${first}</a>`} ${next && html`<a href=${at(next)} rel="next">${more}</a>`}
  </nav>`;
}
