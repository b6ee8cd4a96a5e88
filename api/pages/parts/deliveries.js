/** What was sent to webhooks, and what came of it. */

import { moment } from "../lib/format.js";
import { html } from "../lib/html.js";
import { href } from "../lib/route.js";

/** items: of a listing of deliveries. what: the heading of the column that differs, `job` or `webhook`. */
export const Deliveries = ({ items, what }) => html`<div class="table stacking" tabindex="0" role="region" aria-label="Deliveries"><table>
  <thead><tr><th>When</th><th>Event</th><th>${what === "job" ? "Job" : "Webhook"}</th><th class="number">Tries</th><th>Outcome</th></tr></thead>
  <tbody>${items.map((one) => html`<tr key=${one.id}>
    <td data-label="When"><time datetime=${one.created_at}>${moment(one.created_at)}</time></td>
    <td data-label="Event">${one.event}</td>
    ${what === "job"
      ? html`<td data-label="Job">${one.job ? html`<a href=${href(["jobs", one.job])}>${one.job}</a>` : "–"}</td>`
      : html`<td data-label="Webhook">${one.webhook}</td>`}
    <td data-label="Tries" class="number">${one.attempts}</td>
    <td data-label="Outcome">${outcomeOf(one)}</td>
  </tr>`)}</tbody>
</table></div>`;

function outcomeOf({ status, answer, error, next_attempt_at: next }) {
  if (status === "delivered") return `delivered${answer ? ` (${answer})` : ""}`;
  return `${status}: ${error || "not tried yet."}${next ? ` Next try ${moment(next)}.` : ""}`;
}
