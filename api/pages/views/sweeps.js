/** All sweeps, newest first. */

import { get } from "../lib/api.js";
import { ago, value } from "../lib/format.js";
import { html } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { href } from "../lib/route.js";
import { session } from "../lib/session.js";
import { isOver, objectivesOf, title } from "../lib/sweep.js";
import { Empty, Failure, Loading, Pages } from "../parts/elements.js";
import { Status } from "../parts/job_row.js";
import { WHOSE, whose, WhoseFilters } from "../parts/whose.js";

const LIMIT = 50;

export default function Sweeps({ query }) {
  const cursor = query.get("cursor");
  const asked = Object.fromEntries(WHOSE.map((name) => [name, query.getAll(name)]));
  const { data, error, again } = useLive(
    (signal) => get("/sweeps", { ...asked, cursor, limit: LIMIT }, { signal }),
    [JSON.stringify(asked), cursor],
    (page) => (page.items.some((sweep) => !isOver(sweep)) ? 3000 : 10_000),
  );
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="sweeps" />`;
  return html`<div class="stack">
    <div class="title">
      <h1>Sweeps</h1>
      <a class="button" href="#/sweeps/new">Start a sweep</a>
    </div>
    <${Filters} asked=${asked} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data.items.length && html`<${Empty}>
      <p>No sweeps yet.</p>
      <p><a class="button" href="#/sweeps/new">Start the first one</a></p>
      <p>Or from a shell: <code>gaitway sweep sweep.json</code></p>
    <//>`}
    ${data.items.length > 0 && html`<div class="card table" tabindex="0" role="region" aria-label="Sweeps"><table>
      <thead><tr><th>Sweep</th><th>Method</th><th>Status</th><th class="number">Trials</th><th>Best</th><th>Began</th></tr></thead>
      <tbody>${data.items.map((sweep) => html`<${Row} key=${sweep.id} sweep=${sweep} />`)}</tbody>
    </table></div>`}
    <${Pages} path=${["sweeps"]} query=${query} next=${data.next} name="Pages of sweeps" first="Newest" more="Older sweeps" />
  </div>`;
}

const Filters = ({ asked }) => session().accounts && html`<search class="filters"><${WhoseFilters} asked=${asked} /></search>`;

function Row({ sweep }) {
  const begun = Object.values(sweep.num_trials).reduce((sum, number) => sum + number, 0);
  const [best] = sweep.best;
  return html`<tr>
    <td><a href=${href(["sweeps", sweep.id])}>${title(sweep)}</a>${session().accounts && html`<span class="facts">${whose(sweep)}</span>`}</td>
    <td>${sweep.spec.method}</td>
    <td><${Status} job=${sweep} /></td>
    <td class="number">${begun} of ${sweep.max_trials}</td>
    <td>${best ? html`${value(best.values[0])} <span class="facts">${objectivesOf(sweep)[0].metric}</span>` : "–"}</td>
    <td><time datetime=${sweep.created_at}>${ago(sweep.created_at)}</time></td>
  </tr>`;
}
