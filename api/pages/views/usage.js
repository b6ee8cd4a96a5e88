/** What was used, by project and user, what is left of quotas, and how busy each device was. */

import { get } from "../lib/api.js";
import { bytes, count, moment } from "../lib/format.js";
import { html } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { change } from "../lib/route.js";
import { BusyHours, busyShare, percent } from "../parts/busy_hours.js";
import { Failure, Loading } from "../parts/elements.js";
import { Quotas } from "../parts/quotas.js";
import { Retention } from "../parts/retention.js";

const WINDOWS = { 1: "the last day", 7: "the last 7 days", 30: "the last 30 days", 365: "the last year" };
const DAY_MS = 86_400_000;
const MOST_SHOWN = 100;

export default function Usage({ query }) {
  const days = query.get("days") in WINDOWS ? query.get("days") : "7";
  const since = () => new Date(Date.now() - days * DAY_MS).toISOString();
  const load = (signal) => Promise.all([get("/usage", { since: since() }, { signal }), get("/quotas", {}, { signal })]);
  const { data, error, again } = useLive(load, [days], 15_000);
  return html`<div class="stack">
    <h1>Usage</h1>
    <div class="tools">
      <label>In
        <select value=${days} onChange=${(event) => change({ days: event.target.value })}>
          ${Object.entries(WINDOWS).map(([value, text]) => html`<option key=${value} value=${value}>${text}</option>`)}
        </select>
      </label>
    </div>
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="usage" />`}
    ${data && html`<${Projects} usage=${data[0]} />`}
    ${data?.[1].items.length > 0 && html`<section class="card"><h2>Quotas</h2><${Quotas} items=${data[1].items} /></section>`}
    ${data && html`<${Devices} usage=${data[0]} />`}
    <${Retention} project=${query.get("project")} />
  </div>`;
}

function Projects({ usage }) {
  const most = Math.max(...usage.projects.map((used) => used.gpu_seconds || used.seconds), 1);
  return html`<section class="card"><h2>By project and user</h2>
    <p class="facts">Since ${moment(usage.since)}. Running attempts are counted up to now, and what deleted jobs have used stays counted.</p>
    ${usage.projects.length === 0 && html`<p class="facts">Nothing was used.</p>`}
    ${usage.projects.length > 0 && html`<div class="table stacking" tabindex="0" role="region" aria-label="By project and user"><table>
      <thead><tr><th>Project</th><th>User</th><th class="number">GPU hours</th><th class="number">Hours</th><th class="number">Attempts</th><th class="number">Jobs ended</th><th class="number">Running</th><th class="number">Waiting</th><th class="number">Stored</th><th>Share</th></tr></thead>
      <tbody>${usage.projects.map((used) => html`<tr key=${`${used.project}/${used.owner}`}>
        <td data-label="Project">${used.project}</td>
        <td data-label="User">${used.owner || "–"}</td>
        <td data-label="GPU hours" class="number">${hours(used.gpu_seconds)}</td>
        <td data-label="Hours" class="number">${hours(used.seconds)}</td>
        <td data-label="Attempts" class="number">${count(used.attempts)}</td>
        <td data-label="Jobs ended" class="number">${count(used.jobs)}</td>
        <td data-label="Running" class="number">${count(used.running)}</td>
        <td data-label="Waiting" class="number">${count(used.queued)}</td>
        <td data-label="Stored" class="number">${bytes(used.bytes)}</td>
        <td data-label="Share"><svg class="share" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true"><rect width=${(100 * (used.gpu_seconds || used.seconds)) / most} height="8" /></svg></td>
      </tr>`)}</tbody>
    </table></div>`}
  </section>`;
}

function Devices({ usage }) {
  const shown = [...usage.devices].sort((one, other) => busyShare(usage, other.seconds) - busyShare(usage, one.seconds)).slice(0, MOST_SHOWN);
  return html`<section class="card"><h2>By device, in the last day</h2>
    ${shown.length === 0 && html`<p class="facts">No device had a job.</p>`}
    ${shown.length > 0 && html`<div class="table stacking" tabindex="0" role="region" aria-label="By device"><table>
      <thead><tr><th>Host</th><th>Device</th><th class="number">Busy</th><th>By hour</th></tr></thead>
      <tbody>${shown.map(({ host, device, seconds }) => html`<tr key=${`${host}:${device}`}>
        <td data-label="Host">${host}</td>
        <td data-label="Device">${device || "–"}</td>
        <td data-label="Busy" class="number">${percent(busyShare(usage, seconds))}</td>
        <td data-label="By hour"><${BusyHours} usage=${usage} seconds=${seconds} name="${host}, ${device}" /></td>
      </tr>`)}</tbody>
    </table></div>`}
    ${usage.devices.length > MOST_SHOWN && html`<p class="facts">The ${MOST_SHOWN} busiest of ${count(usage.devices.length)} are shown.</p>`}
  </section>`;
}

const hours = (seconds) => (seconds / 3600).toLocaleString("en", { maximumFractionDigits: seconds < 36_000 ? 2 : 0 });
