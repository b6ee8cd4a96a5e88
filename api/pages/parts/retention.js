/** What a project keeps of its ended jobs: its rules, what other rules would remove, and a form to set them. */

import { get, post, remove, send } from "../lib/api.js";
import { useSubmission } from "../lib/draft.js";
import { bytes, count, moment } from "../lib/format.js";
import { html, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { change, href } from "../lib/route.js";
import { isAdmin, session } from "../lib/session.js";
import { Confirm, Failure, Loading, Prose } from "./elements.js";
import { useProjects } from "./whose.js";

const RULES = {
  checkpoints: { label: "Checkpoints kept of each job", says: (number) => `of each job the newest ${many(number, "checkpoint")} stay` },
  videos_days: { label: "Videos, days", says: (days) => `videos go after ${days} days` },
  replays_days: { label: "Replays and trajectories, days", says: (days) => `replays and trajectories go after ${days} days` },
  failed_days: { label: "Failed jobs, days", says: (days) => `failed jobs go after ${days} days, with all that they have` },
  cancelled_days: { label: "Cancelled jobs, days", says: (days) => `cancelled jobs go after ${days} days, with all that they have` },
};

const many = (number, one) => `${count(number)} ${one}${number === 1 ? "" : "s"}`;

/** The rules that say something, as the service takes them. */
const given = (values) => Object.fromEntries(Object.keys(RULES).flatMap((name) => (values[name] || values[name] === 0 ? [[name, Number(values[name])]] : [])));

/** project: of the address; by default the first of one's own. */
export function Retention({ project: asked }) {
  const projects = useProjects();
  const project = asked || projects[0] || "default";
  const path = `/projects/${encodeURIComponent(project)}/retention`;
  const { data, error, again } = useLive((signal) => get(path, {}, { signal }), [path]);
  return html`<section class="card stack" aria-label="What is kept"><h2>What is kept of ended jobs</h2>
    ${projects.length > 1 && html`<div class="tools"><label>Project
      <select value=${project} onChange=${({ target }) => change({ project: target.value })}>${projects.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}</select>
    </label></div>`}
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="the rules" />`}
    ${data && html`<${Said} rules=${data} path=${path} again=${again} /><${Form} key=${`${path} ${data.set_at}`} rules=${data} path=${path} onSet=${again} />`}
  </section>`;
}

const maySet = () => !session().accounts || isAdmin();

function Said({ rules, path, again }) {
  const [problem, setProblem] = useState(null);
  if (!rules.set_at) return html`<p class="facts">${rules.project} has no rules and keeps everything.</p>`;
  const parts = Object.entries(given(rules)).map(([name, number]) => RULES[name].says(number));
  return html`<p>In ${rules.project}, ${parts.join("; ")}.</p>
    <p class="facts">Set ${moment(rules.set_at)}${rules.set_by ? ` by ${rules.set_by}` : ""}, and applied every hour. Policies, metrics and logs of jobs that stay always stay, and so do jobs with the label keep.</p>
    ${maySet() && html`<p><${Confirm} text="Keep everything" question="From now on ${rules.project} keeps everything?" onYes=${() => remove(path).then(again, setProblem)} /></p>`}
    ${problem && html`<p class="error" role="alert">${problem.message}</p>`}`;
}

function Form({ rules, path, onSet }) {
  const [draft, setDraft] = useState(() => Object.fromEntries(Object.keys(RULES).map((name) => [name, rules[name] ?? ""])));
  const [seen, setSeen] = useState(null);
  const wanted = given(draft);
  const isSeen = seen && JSON.stringify(seen.wanted) === JSON.stringify(wanted);
  const set = (name) => ({ target }) => setDraft((before) => ({ ...before, [name]: target.value }));
  const { problem, isBusy, reset, submit } = useSubmission(async () => {
    if (isSeen) {
      await send(path, { method: "PUT", body: JSON.stringify(wanted), type: "application/json" });
      onSet();
    } else {
      setSeen({ wanted, found: await post(`${path}/preview`, wanted) });
    }
    reset();
  }, wanted);
  return html`<form class="stack" onSubmit=${submit} novalidate aria-label="Rules">
    <div class="tools">
      ${Object.entries(RULES).map(([name, { label }]) => html`<label key=${name}>${label} <input type="number" min="1" step="1" inputmode="numeric" value=${draft[name]} onInput=${set(name)} placeholder="all" /></label>`)}
    </div>
    ${isSeen && html`<${Preview} found=${seen.found} />`}
    <p class="actions">
      ${(!isSeen || !maySet()) && html`<button class="main" disabled=${isBusy || !Object.keys(wanted).length}>Show what these rules remove</button>`}
      ${isSeen && maySet() && html`<button class="danger" disabled=${isBusy}>Set these rules</button>`}
    </p>
    ${problem && html`<p class="error" role="alert"><${Prose} text=${problem.message} /></p>`}
  </form>`;
}

function Preview({ found }) {
  return html`<div class="stack" role="status">
    <p><strong>${many(found.jobs, "job")} would lose ${many(found.files, "file")}, ${bytes(found.bytes)}.</strong>
      ${found.whole_jobs > 0 && ` ${count(found.whole_jobs)} of these jobs would go as a whole.`}
      ${found.pinned > 0 && ` ${many(found.pinned, "job")} with the label keep would lose nothing.`}</p>
    ${found.roles.length > 0 && html`<p class="facts">${found.roles.map((one) => `${count(one.files)} × ${one.role}, ${bytes(one.bytes)}`).join(" · ")}</p>`}
    ${found.largest.length > 0 && html`<div class="table stacking" tabindex="0" role="region" aria-label="Jobs that lose most"><table>
      <thead><tr><th>Job</th><th>Owner</th><th>Loses</th><th class="number">Size</th></tr></thead>
      <tbody>${found.largest.map((one) => html`<tr key=${one.job}>
        <td data-label="Job"><a href=${href(["jobs", one.job])}>${one.name || one.job}</a></td>
        <td data-label="Owner">${one.owner || "–"}</td>
        <td data-label="Loses">${one.whole ? "everything" : many(one.files, "file")}</td>
        <td data-label="Size" class="number">${bytes(one.bytes)}</td>
      </tr>`)}</tbody>
    </table></div>`}
    ${found.jobs > found.largest.length && html`<p class="facts">And ${count(found.jobs - found.largest.length)} more.</p>`}
    ${found.needed.map((one) => html`<p class="facts" key=${one.job}>Something of <a href=${href(["jobs", one.job])}>${one.name || one.job}</a> stays: ${neededBy(one)} needs it.</p>`)}
    ${found.num_needed > found.needed.length && html`<p class="facts">So it is with ${count(found.num_needed - found.needed.length)} more.</p>`}
  </div>`;
}

const neededBy = ({ sweep, needed_by: jobs }) => (sweep ? `sweep ${sweep}` : jobs.length ? `job ${jobs.join(", ")}` : "a job of another project");
