/** A job's files. */

import { bytes, count, moment } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { isOver } from "../../lib/job.js";
import { Empty } from "../../parts/elements.js";

export function FilesTab({ job }) {
  if (!job.artifacts.length) {
    return html`<${Empty}><p>${isOver(job) ? "The job left no files." : "No files yet: the first come with the first checkpoint."}</p><//>`;
  }
  const pictures = job.artifacts.filter((file) => file.role === "picture");
  return html`<div class="stack">
    <div class="table card" tabindex="0" role="region" aria-label="Files"><table>
      <thead><tr><th>Name</th><th>Role</th><th class="number">Step</th><th class="number">Size</th><th>SHA-256</th></tr></thead>
      <tbody>${job.artifacts.map(
        (file) => html`<tr key=${file.name}>
          <td><a href=${file.href} download=${file.name}>${file.name}</a></td>
          <td>${file.role}</td><td class="number">${file.step === null ? "" : count(file.step)}</td>
          <td class="number">${bytes(file.size)}</td><td title=${file.sha256}><code>${file.sha256.slice(0, 12)}</code></td>
        </tr>`,
      )}</tbody>
    </table></div>
    ${job.removed?.map((one) => html`<p class="facts" key=${one.rule}>The project's retention rule ${one.rule} has removed ${count(one.files)} files of it, ${bytes(one.bytes)}, the last ${moment(one.at)}.</p>`)}
    ${pictures.length > 0 &&
    html`<div class="grid">${pictures.map(
      (file) => html`<figure class="card" key=${file.name}><img src=${file.href} alt=${file.name} loading="lazy" /><figcaption class="facts">${file.name}</figcaption></figure>`,
    )}</div>`}
  </div>`;
}
