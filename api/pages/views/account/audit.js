/** The audit log: who did what, when and from where; a page at a time. */

import { get } from "../../lib/api.js";
import { moment } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { change, href } from "../../lib/route.js";
import { Failure, Loading, Pages } from "../../parts/elements.js";

const FILTERS = { user: "ann", action: "job. or token.revoked", object: "job 019aa3…" };
const LIMIT = 50;

export function Audit({ query }) {
  const asked = Object.fromEntries(Object.keys(FILTERS).map((name) => [name, query.get(name) || ""]));
  const cursor = query.get("cursor");
  const { data, error, again } = useLive((signal) => get("/audit", { ...asked, cursor, limit: LIMIT }, { signal }), [JSON.stringify(asked), cursor]);
  const set = (name) => ({ target }) => change({ [name]: target.value.trim(), cursor: [] });
  return html`
    <search class="filters">
      ${Object.entries(FILTERS).map(([name, example]) => html`<label key=${name}>${name} <input type="search" value=${asked[name]} placeholder=${example} onChange=${set(name)} /></label>`)}
    </search>
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="the audit log" />`}
    ${data && !data.items.length && html`<p class="facts">Nothing was done that matches.</p>`}
    ${data?.items.length > 0 && html`<div class="card table stacking" tabindex="0" role="region" aria-label="Audit log"><table>
      <thead><tr><th>When</th><th>Who</th><th>What</th><th>Object</th><th>Details</th><th>From</th></tr></thead>
      <tbody>${data.items.map((entry) => html`<tr key=${entry.id}>
        <td data-label="When"><time datetime=${entry.at}>${moment(entry.at)}</time></td>
        <td data-label="Who">${entry.user || "the service"}</td>
        <td data-label="What">${entry.action}</td>
        <td data-label="Object"><${About} text=${entry.object} /></td>
        <td data-label="Details">${detailsOf(entry)}</td>
        <td data-label="From">${entry.address || "–"}</td>
      </tr>`)}</tbody>
    </table></div>`}
    ${data && html`<${Pages} path=${["account", "audit"]} query=${query} next=${data.next} name="Pages of the audit log" first="Newest" more="Older entries" />`}
  `;
}

// The kinds of things that have a view.
const VIEWS = { job: "jobs", sweep: "sweeps" };

function About({ text }) {
  const [kind, id] = (text || "–").split(" ");
  return VIEWS[kind] ? html`${kind} <a href=${href([VIEWS[kind], id])}>${id}</a>` : html`${text || "–"}`;
}

const detailsOf = ({ details }) => Object.entries(details).map(([name, value]) => `${name}: ${[value].flat().join(", ")}`).join("; ") || "–";
