/** What was sent to webhooks, and what came of it. */

import { post } from "../lib/api.js";
import { moment } from "../lib/format.js";
import { html, useState } from "../lib/html.js";
import { href } from "../lib/route.js";

/**
 * items: of a listing of deliveries. what: the heading of the column that differs, `job` or `webhook`.
 * onSent: called once one is sent again, where the reader may do that.
 */
export const Deliveries = ({ items, what, onSent }) => html`<div class="table stacking" tabindex="0" role="region" aria-label="Deliveries"><table>
  <thead><tr><th>When</th><th>Event</th><th>${what === "job" ? "Job" : "Webhook"}</th><th class="number">Tries</th><th>Outcome</th>${onSent && html`<th>Do</th>`}</tr></thead>
  <tbody>${items.map((one) => html`<tr key=${one.id}>
    <td data-label="When"><time datetime=${one.created_at}>${moment(one.created_at)}</time></td>
    <td data-label="Event">${one.event}</td>
    ${what === "job"
      ? html`<td data-label="Job">${one.job ? html`<a href=${href(["jobs", one.job])}>${one.job}</a>` : "–"}</td>`
      : html`<td data-label="Webhook">${one.webhook}</td>`}
    <td data-label="Tries" class="number">${one.attempts}</td>
    <td data-label="Outcome">${outcomeOf(one)}</td>
    ${onSent && html`<td data-label="Do"><${Again} id=${one.id} onSent=${onSent} /></td>`}
  </tr>`)}</tbody>
</table></div>`;

function Again({ id, onSent }) {
  const [problem, setProblem] = useState(null);
  const send = () => post(`/deliveries/${id}/resend`).then(onSent, setProblem);
  return html`<span><button type="button" onClick=${send} aria-label="Send again: ${id}">Send again</button>
    ${problem && html`<span class="error" role="alert">${problem.message}</span>`}</span>`;
}

function outcomeOf({ status, answer, error, next_attempt_at: next }) {
  if (status === "delivered") return `delivered${answer ? ` (${answer})` : ""}`;
  return `${status}: ${error || "not tried yet."}${next ? ` Next try ${moment(next)}.` : ""}`;
}
