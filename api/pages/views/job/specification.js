/** What was asked for, beside what defaults filled in. */

import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { settingsOf } from "../../lib/job.js";
import { Copy, Failure, Loading } from "../../parts/elements.js";

export const shown = (value) => (typeof value === "string" ? value : JSON.stringify(value));

export function SpecificationTab({ job }) {
  const { data: settings, error, again } = useLive(() => settingsOf(job), [job.id, job.attempts.length]);
  const [part, setPart] = useState("");
  const rows = (settings || []).filter(({ path }) => path.toLowerCase().includes(part.toLowerCase()));
  return html`<div class="halves">
    <section class="card"><h2>As it was sent</h2><${Copy} text=${JSON.stringify(job.spec, null, 2)} name="The specification as it was sent" /></section>
    <section class="card"><h2>As it runs</h2>
      ${error && html`<${Failure} error=${error} again=${again} />`}
      ${!settings && !error && html`<${Loading} what="the defaults" />`}
      ${settings && html`
        <div class="tools"><label>Settings <input type="search" placeholder="part of a name" value=${part} onInput=${(event) => setPart(event.target.value)} /></label></div>
        <div class="table tall" tabindex="0" role="region" aria-label="All settings"><table>
          <thead><tr><th>Setting</th><th>Value</th><th>From</th></tr></thead>
          <tbody>${rows.map(
            ({ path, value, origin }) => html`<tr key=${path}><td>${path}</td><td><code>${shown(value)}</code></td>
              <td>${origin === "sent" ? html`<strong>sent</strong>` : origin}</td></tr>`,
          )}</tbody>
        </table></div>`}
    </section>
  </div>`;
}
