/** All jobs as a table: newest first, or sorted by a column; a sweep is one row. What is shown stands in the address. */

import { get } from "../lib/api.js";
import { count } from "../lib/format.js";
import { html, useEffect, useRef } from "../lib/html.js";
import { isOver } from "../lib/job.js";
import { useLive } from "../lib/live.js";
import { change } from "../lib/route.js";
import { isOver as isSweepOver } from "../lib/sweep.js";
import { Empty, Failure, Loading, Pages } from "../parts/elements.js";
import { ColumnMenu, useColumns } from "./jobs/columns.js";
import { Filters, FILTERS } from "./jobs/filters.js";
import { Import } from "./jobs/import.js";
import { Picked } from "./jobs/picked.js";
import { Order, Table } from "./jobs/table.js";

const LIMIT = 25;
const EVERY = "all"; // In the address: no sweep is folded.

/** What the address says of the list, as the service is asked. */
function askedBy(query) {
  const filters = Object.fromEntries(FILTERS.map((name) => [name, query.getAll(name)]));
  const isOneSweep = filters.label.some((label) => /^sweep[:=]/.test(label));
  const sweep = query.get("sweep") || (isOneSweep ? EVERY : "folded");
  const order = { sort: query.get("sort"), order: query.get("sort") && (query.get("order") || "desc") };
  return { filters, order, sweep: sweep === EVERY ? "" : sweep };
}

/** The last data that there were: a table that is sorted anew stays until the other order comes. */
function useLast(data) {
  const last = useRef(null);
  if (data) last.current = data;
  return last.current;
}

export default function Jobs({ query }) {
  const asked = askedBy(query);
  const cursor = query.get("cursor");
  const picked = query.getAll("pick");
  const isOfSweep = !["", "folded"].includes(asked.sweep);
  const { data, error, again } = useLive(
    (signal, isRepeated) =>
      get("/jobs", { ...asked.filters, ...asked.order, sweep: asked.sweep, cursor, limit: LIMIT }, { signal, maxAge: isRepeated ? 1 : 0 }),
    [JSON.stringify(asked), cursor],
    (page) => (page.items.some((job) => !isOver(job)) ? 2000 : 5000),
  );
  const page = useLast(data);
  const sweeps = useSweeps(asked.sweep === "folded" ? page : null);
  const known = useKnown(page);
  const columns = useColumns(page?.items || []);
  const isFiltered = isOfSweep || Object.values(asked.filters).some((values) => values.length);
  return html`
    <div class="title">
      <h1>Jobs</h1>
      <a class="button" href="#/submit">Submit a job</a>
    </div>
    <${Filters} asked=${asked.filters} />
    <div class="tools of-table">
      <${Order} columns=${columns} order=${asked.order} />
      ${isOfSweep
        ? html`<button type="button" class="label" aria-label="Remove the filter sweep" onClick=${() => change({ sweep: [], cursor: [] })}>one sweep ×</button>`
        : html`<label class="inline"><input type="checkbox" checked=${asked.sweep === "folded"} onChange=${({ target }) => change({ sweep: target.checked ? [] : EVERY, cursor: [] })} />Fold sweeps</label>`}
      <${ColumnMenu} columns=${columns} />
    </div>
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!page && !error && html`<${Loading} what="jobs" />`}
    ${data && !data.items.length && html`<${Nothing} isFiltered=${isFiltered || cursor} />`}
    ${page && page.items.length > 0 && (data || !error) &&
    html`<${Table} page=${page} isOld=${!data} sweeps=${sweeps} columns=${columns} asked=${asked} picked=${picked} known=${known} />`}
    ${page?.of_newest && html`<p class="facts">Sorted are the newest ${count(page.of_newest)} jobs; older ones are in the table newest first.</p>`}
    ${data && html`<${Pages} path=${["jobs"]} query=${query} next=${data.next} name="Pages of jobs" first=${asked.order.sort ? "First" : "Newest"} more=${asked.order.sort ? "More jobs" : "Older jobs"} />`}
    <${Import} />
    ${picked.length > 0 && html`<${Picked} ids=${picked} known=${known} again=${again} />`}
  `;
}

/** The documents of the sweeps on a page, by id. */
function useSweeps(page) {
  const ids = [...new Set((page?.items || []).map((job) => job.sweep).filter(Boolean))].sort();
  const { data } = useLive(
    async (signal) => (ids.length ? (await get("/sweeps", { id: ids, limit: 200 }, { signal })).items : []),
    [ids.join()],
    (sweeps) => (sweeps.some((sweep) => !isSweepOver(sweep)) ? 4000 : 0),
  );
  return new Map((useLast(data) || []).map((sweep) => [sweep.id, sweep]));
}

/** Jobs by id as they were last seen, also on other pages: of what is picked, one wants to know what it is. */
function useKnown(page) {
  const known = useRef(new Map());
  useEffect(() => page?.items.forEach((job) => known.current.set(job.id, job)), [page]);
  return known.current;
}

const Nothing = ({ isFiltered }) =>
  html`<${Empty}>
    ${isFiltered
      ? html`<p>No job matches these filters.</p><p><a href="#/jobs">Show all jobs</a></p>`
      : html`<p>No jobs yet.</p>
          <p><a class="button" href="#/submit">Submit the first one</a></p>
          <p>Or from a shell: <code>gaitway submit ant</code></p>`}
  <//>`;
