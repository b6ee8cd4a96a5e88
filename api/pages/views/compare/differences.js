/** Only the settings in which jobs differ. */

import { html } from "../../lib/html.js";
import { lastReturn } from "../../lib/job.js";
import { value as number } from "../../lib/format.js";
import { Failure, Loading } from "../../parts/elements.js";
import { shown } from "../job/specification.js";

/**
 * @param {{path: string, value: any}[][]} settings Of each job.
 * @returns {[string, any[]][]} Paths with the value of each job; undefined where a job has no such setting.
 */
export function differing(settings) {
  const tables = settings.map((rows) => new Map(rows.map(({ path, value }) => [path, value])));
  const paths = [...new Set(settings.flatMap((rows) => rows.map(({ path }) => path)))];
  const rows = paths.map((path) => [path, tables.map((table) => table.get(path))]);
  return rows.filter(([, values]) => new Set(values.map((value) => JSON.stringify(value))).size > 1);
}

export function Differences({ jobs, settings, error }) {
  const isComplete = settings?.length === jobs.length;
  const rows = isComplete ? differing(settings) : [];
  return html`<section class="card"><h2>Settings that differ</h2>
    ${error && html`<${Failure} error=${error} />`}
    ${!isComplete && !error && html`<${Loading} what="the settings" />`}
    ${isComplete && html`<div class="table tall" tabindex="0" role="region" aria-label="Settings that differ"><table>
      <thead><tr><th>Setting</th>${jobs.map((job) => html`<th key=${job.id}>${job.label}</th>`)}</tr></thead>
      <tbody>
        <tr><td>status</td>${jobs.map((job) => html`<td>${job.status}</td>`)}</tr>
        <tr><td>last return</td>${jobs.map((job) => html`<td>${number(lastReturn(job))}</td>`)}</tr>
        ${rows.map(([path, values]) => html`<tr key=${path}><td>${path}</td>${values.map((value) => html`<td><code>${value === undefined ? "–" : shown(value)}</code></td>`)}</tr>`)}
      </tbody>
    </table></div>
    ${!rows.length && jobs.length > 1 ? html`<p class="facts">All settings are the same.</p>` : null}`}
  </section>`;
}
