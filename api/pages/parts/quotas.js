/** Quotas, with what is used of each. */

import { bytes, count } from "../lib/format.js";
import { html } from "../lib/html.js";

const PARTS = { running: ["Running", count], queued: ["Waiting", count], gpu_hours: ["GPU hours in 7 days", hours], bytes: ["Stored", bytes] };

/** items: as `GET /quotas` has them. Do: a component for what may be done about a quota. */
export const Quotas = ({ items, Do }) => html`<div class="table stacking" tabindex="0" role="region" aria-label="Quotas"><table>
  <thead><tr><th>Of</th><th class="number">Weight</th>${Object.entries(PARTS).map(([part, [title]]) => html`<th key=${part} class="number">${title}</th>`)}<th>Highest priority</th>${Do && html`<th>Do</th>`}</tr></thead>
  <tbody>${items.map((quota) => html`<tr key=${`${quota.kind} ${quota.name}`}>
    <td data-label="Of">${quota.kind} ${quota.name}</td>
    <td data-label="Weight" class="number">${quota.weight}</td>
    ${Object.entries(PARTS).map(([part, [title, write]]) => html`<td key=${part} data-label=${title} class="number">${ofLimit(write, quota.used[part], quota[part])}</td>`)}
    <td data-label="Highest priority">${quota.highest_priority}</td>
    ${Do && html`<td data-label="Do"><${Do} quota=${quota} /></td>`}
  </tr>`)}</tbody>
</table></div>`;

function hours(number) {
  return number.toLocaleString("en", { maximumFractionDigits: 1 });
}

const ofLimit = (write, used, most) => (most === null ? write(used) : `${write(used)} of ${write(most)}`);
