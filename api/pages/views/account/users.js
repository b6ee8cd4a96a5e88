/** Users: added, with their roles; disabled. */

import { get, patch, post } from "../../lib/api.js";
import { useSubmission } from "../../lib/draft.js";
import { ago } from "../../lib/format.js";
import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { href } from "../../lib/route.js";
import { ROLES } from "../../lib/session.js";
import { Confirm, Failure, Loading } from "../../parts/elements.js";

const changed = (name, change) => patch(`/users/${encodeURIComponent(name)}`, change);

export function Users() {
  const { data, error, again } = useLive((signal) => Promise.all([get("/users", {}, { signal }), get("/projects", {}, { signal })]), []);
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="users" />`;
  const [users, projects] = data;
  return html`
    <${NewUser} projects=${projects.items.map(({ name }) => name)} onAdded=${again} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    <div class="card table stacking" tabindex="0" role="region" aria-label="Users"><table>
      <thead><tr><th>User</th><th>Role</th><th>Projects</th><th>Added</th><th>Access</th></tr></thead>
      <tbody>${users.items.map((user) => html`<${Row} key=${user.name} user=${user} again=${again} />`)}</tbody>
    </table></div>`;
}

function Row({ user, again }) {
  const [problem, setProblem] = useState(null);
  const change = (parts) => (setProblem(null), changed(user.name, parts).then(again, (error) => (setProblem(error), again())));
  return html`<tr>
    <td data-label="User"><span>${user.name}${user.subject && html` <span class="facts" title=${user.subject}>(signs in at the provider)</span>`}</span></td>
    <td data-label="Role"><select aria-label="Role of ${user.name}" value=${user.role} onChange=${({ target }) => change({ role: target.value })}>
      ${ROLES.map((role) => html`<option key=${role} value=${role}>${role}</option>`)}
    </select></td>
    <td data-label="Projects">${user.projects.join(", ") || "none"}</td>
    <td data-label="Added">${ago(user.created_at)}</td>
    <td data-label="Access"><span class="actions">
      <a href=${href(["account", "tokens"], { user: user.name })}>Tokens<span class="unseen"> of ${user.name}</span></a>
      ${user.active
        ? html`<${Confirm} text="Disable" question="Refuse ${user.name}’s tokens and sessions?" onYes=${() => change({ active: false })} isDangerous />`
        : html`<span class="facts">disabled</span> <button type="button" onClick=${() => change({ active: true })}>Enable</button>`}
      ${problem && html`<span class="error" role="alert">${problem.message}</span>`}
    </span></td>
  </tr>`;
}

function NewUser({ projects, onAdded }) {
  const [draft, setDraft] = useState({ name: "", role: "submitter", projects: ["default"] });
  const set = (name, value) => setDraft((before) => ({ ...before, [name]: value }));
  const { problem, isBusy, reset, submit } = useSubmission(async () => {
    await post("/users", draft);
    set("name", "");
    reset();
    onAdded();
  }, draft);
  const tick = (project) => ({ target }) => set("projects", target.checked ? [...draft.projects, project] : draft.projects.filter((one) => one !== project));
  return html`<form class="card stack" onSubmit=${submit} novalidate aria-label="Add a user">
    <h2>Add a user</h2>
    <div class="tools">
      <label>Name <input value=${draft.name} onInput=${({ target }) => set("name", target.value)} autocapitalize="off" aria-invalid=${problem ? "true" : undefined} /></label>
      <label>Role <select value=${draft.role} onChange=${({ target }) => set("role", target.value)}>${ROLES.map((role) => html`<option key=${role} value=${role}>${role}</option>`)}</select></label>
      <button class="main" disabled=${isBusy || !draft.name}>Add</button>
    </div>
    <div class="ticks" role="group" aria-label="Projects of the user">
      ${projects.map((project) => html`<label class="tick" key=${project}><input type="checkbox" checked=${draft.projects.includes(project)} onChange=${tick(project)} /> ${project}</label>`)}
    </div>
    ${problem && html`<p class="error" role="alert">${problem.message}</p>`}
  </form>`;
}
