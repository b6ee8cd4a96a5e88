/** The table of jobs: a header that sorts, a row for each job, and one for each sweep that opens to its trials. */

import { get } from "../../lib/api.js";
import { html, useState } from "../../lib/html.js";
import { isOver, seedsOf, title } from "../../lib/job.js";
import { useLive } from "../../lib/live.js";
import { change, href, useRoute } from "../../lib/route.js";
import { title as titleOfSweep } from "../../lib/sweep.js";

const MOST_TRIALS = 25; // Of an open sweep; its own view has all.

/** A click sorts by the column, a second one the other way round, and a third one takes the order away. */
function sortBy({ sort, first = "desc" }, order) {
  const other = first === "desc" ? "asc" : "desc";
  const next = order.sort !== sort ? first : order.order === first ? other : null;
  change({ sort: next ? sort : [], order: next || [], cursor: [] });
}

const NAME = { name: "name", title: "Name", sort: "name", first: "asc" };

/** For narrow windows, where the table has no header. */
export function Order({ columns, order }) {
  const sortable = [NAME, ...columns.shown].filter((column) => column.sort);
  const choose = ({ target }) => {
    const column = sortable.find(({ sort }) => sort === target.value);
    change({ sort: target.value, order: column ? column.first || "desc" : [], cursor: [] });
  };
  return html`<span class="order">
    <label>Order
      <select value=${order.sort || ""} onChange=${choose}>
        <option value="">newest first</option>
        ${sortable.map((column) => html`<option key=${column.sort} value=${column.sort}>${column.title}</option>`)}
      </select>
    </label>
    ${order.sort && html`<button type="button" aria-label="The other way round" onClick=${() => change({ order: order.order === "asc" ? "desc" : "asc", cursor: [] })}>${order.order === "asc" ? "▲" : "▼"}</button>`}
  </span>`;
}

function Head({ column, order }) {
  const isSorted = column.sort && column.sort === order.sort;
  const way = isSorted ? (order.order === "asc" ? "ascending" : "descending") : undefined;
  return html`<th scope="col" class=${column.isNumber ? "number" : ""} aria-sort=${way}>
    ${column.sort
      ? html`<button type="button" class="plain sorter" onClick=${() => sortBy(column, order)}>${column.title}<span class="way" aria-hidden="true">${isSorted ? (way === "ascending" ? "▲" : "▼") : ""}</span></button>`
      : column.title}
  </th>`;
}

export function Table({ page, isOld, sweeps, columns, asked, picked, known }) {
  const [open, setOpen] = useState(new Set());
  const toggle = (id) => setOpen((before) => new Set(before.has(id) ? [...before].filter((other) => other !== id) : [...before, id]));
  const { query } = useRoute();
  const labelled = (key, value) => {
    const parts = new URLSearchParams(query);
    parts.delete("cursor");
    const label = `${key}:${value}`;
    if (!parts.getAll("label").includes(label)) parts.append("label", label);
    return href(["jobs"], parts);
  };
  const shared = { columns: columns.shown, labelled, picked };
  const jobs = page.items.filter((job) => !sweeps.has(job.sweep));
  return html`<div class="card table of-jobs ${isOld ? "old" : ""}" tabindex="0" role="region" aria-label="Jobs" aria-busy=${isOld}><table>
    <thead><tr>
      <td class="pick"><${PickAll} ids=${jobs.map((job) => job.id)} picked=${picked} /></td>
      ${[NAME, ...columns.shown].map((column) => html`<${Head} key=${column.name} column=${column} order=${asked.order} />`)}
    </tr></thead>
    <tbody>${page.items.map((job) => {
      const sweep = sweeps.get(job.sweep);
      if (!sweep) return html`<${Row} key=${job.id} job=${job} ...${shared} />`;
      return html`<${SweepRow} key=${sweep.id} sweep=${sweep} job=${job} ...${shared} isOpen=${open.has(sweep.id)} toggle=${() => toggle(sweep.id)} />
        ${open.has(sweep.id) && html`<${Trials} key=${`trials ${sweep.id}`} sweep=${sweep} asked=${asked} known=${known} ...${shared} />`}`;
    })}</tbody>
  </table></div>`;
}

function PickAll({ ids, picked }) {
  const are = ids.filter((id) => picked.includes(id)).length;
  if (!ids.length) return null;
  const toggle = () => change({ pick: are === ids.length ? picked.filter((id) => !ids.includes(id)) : [...new Set([...picked, ...ids])] }, true);
  return html`<input type="checkbox" checked=${are === ids.length} indeterminate=${are > 0 && are < ids.length} onChange=${toggle} aria-label="Choose all jobs of this page" />`;
}

function Cells({ columns, contentOf }) {
  return columns.map((column) => html`<td key=${column.name} class="of-${column.name.replace(/:.*/, "")} ${column.isNumber ? "number" : ""}" data-label=${column.title}>${contentOf(column)}</td>`);
}

function Row({ job, columns, labelled, picked, isTrial }) {
  const isPicked = picked.includes(job.id);
  const pick = () => change({ pick: isPicked ? picked.filter((id) => id !== job.id) : [...picked, job.id] }, true);
  return html`<tr class="job ${isTrial ? "trial" : ""} ${isPicked ? "picked-row" : ""}">
    <td class="pick"><input type="checkbox" checked=${isPicked} onChange=${pick} aria-label="Choose ${title(job)}" /></td>
    <th scope="row" class="name"><a href=${href(["jobs", job.id])}>${title(job)}</a><${About} job=${job} isTrial=${isTrial} /></th>
    <${Cells} columns=${columns} contentOf=${({ cell }) => cell(job, labelled)} />
  </tr>`;
}

/** What the name leaves open. */
function About({ job, isTrial }) {
  const seeds = seedsOf(job);
  const parts = [
    isTrial && job.labels.trial !== undefined && `trial ${job.labels.trial}`,
    seeds.length ? `seeds ${seeds.join(", ")}` : job.spec.seed !== undefined && `seed ${job.spec.seed}`,
    job.imported_from && "imported",
  ].filter(Boolean);
  return parts.length ? html`<span class="facts"> ${parts.join(" · ")}</span>` : null;
}

function SweepRow({ sweep, job, columns, labelled, isOpen, toggle }) {
  return html`<tr class="job sweep">
    <td class="pick"><button type="button" class="plain fold" aria-expanded=${isOpen} aria-label="Trials of ${titleOfSweep(sweep)}" onClick=${toggle}>${isOpen ? "▾" : "▸"}</button></td>
    <th scope="row" class="name"><a href=${href(["sweeps", sweep.id])}>${titleOfSweep(sweep)}</a><span class="facts"> sweep · ${sweep.spec.method}</span></th>
    <${Cells} columns=${columns} contentOf=${(column) => (column.sweep ? column.sweep(sweep, job, labelled) : column.cell(job, labelled))} />
  </tr>`;
}

/** The first trials that match the list's filters, in its order. */
function Trials({ sweep, asked, known, columns, labelled, picked }) {
  const { data, error } = useLive(
    async (signal) => {
      const page = await get("/jobs", { ...asked.filters, ...asked.order, sweep: sweep.id, limit: MOST_TRIALS }, { signal });
      page.items.forEach((job) => known.set(job.id, job));
      return page;
    },
    [sweep.id, JSON.stringify(asked)],
    (page) => (page.items.some((job) => !isOver(job)) ? 2000 : 5000),
  );
  const whole = columns.length + 2;
  if (!data) return html`<tr class="trial note"><td colspan=${whole}>${error ? error.message : "Loading trials…"}</td></tr>`;
  return html`${data.items.map((job) => html`<${Row} key=${job.id} job=${job} columns=${columns} labelled=${labelled} picked=${picked} isTrial />`)}
    ${data.next && html`<tr class="trial note"><td colspan=${whole}>These are ${data.items.length}. <a href=${href(["jobs"], { sweep: sweep.id })}>List them all</a></td></tr>`}`;
}
