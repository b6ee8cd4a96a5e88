/** Projects, and who is in them. */

import { get, patch, post } from "../../lib/api.js";
import { useSubmission } from "../../lib/draft.js";
import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { href } from "../../lib/route.js";
import { Failure, Loading } from "../../parts/elements.js";

export function Projects() {
  const { data, error, again } = useLive((signal) => Promise.all([get("/projects", {}, { signal }), get("/users", {}, { signal })]), []);
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="projects" />`;
  const [projects, users] = data;
  return html`
    <${NewProject} onAdded=${again} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    <div class="grid">${projects.items.map((project) => html`<${Project} key=${project.name} project=${project} users=${users.items} again=${again} />`)}</div>`;
}

function Project({ project, users, again }) {
  const [problem, setProblem] = useState(null);
  const change = async (parts) => {
    setProblem(null);
    const path = `/projects/${encodeURIComponent(project.name)}`;
    await patch(path, parts).catch(setProblem);
    again();
  };
  const others = users.filter(({ name }) => !project.members.includes(name));
  return html`<section class="card stack">
    <h2>${project.name}</h2>
    <p class="facts"><a href=${href(["jobs"], { project: project.name })}>Its jobs</a></p>
    ${!project.members.length && html`<p class="facts">No members: admins alone see it.</p>`}
    ${project.members.length > 0 && html`<ul class="labels" aria-label="Members of ${project.name}">
      ${project.members.map((name) => html`<li key=${name}><button type="button" class="label" aria-label="Remove ${name} from ${project.name}" onClick=${() => change({ remove: [name] })}>${name} ×</button></li>`)}
    </ul>`}
    ${others.length > 0 && html`<label class="field">Add a member
      <select value="" onChange=${({ target }) => target.value && change({ add: [target.value] })}>
        <option value="">choose a user</option>
        ${others.map(({ name }) => html`<option key=${name} value=${name}>${name}</option>`)}
      </select>
    </label>`}
    ${problem && html`<p class="error" role="alert">${problem.message}</p>`}
  </section>`;
}

function NewProject({ onAdded }) {
  const [name, setName] = useState("");
  const { problem, isBusy, reset, submit } = useSubmission(async () => {
    await post("/projects", { name });
    setName("");
    reset();
    onAdded();
  }, { name });
  return html`<form class="card stack" onSubmit=${submit} novalidate aria-label="Add a project">
    <h2>Add a project</h2>
    <div class="tools">
      <label>Name <input value=${name} onInput=${({ target }) => setName(target.value)} autocapitalize="off" aria-invalid=${problem ? "true" : undefined} /></label>
      <button class="main" disabled=${isBusy || !name}>Add</button>
    </div>
    ${problem && html`<p class="error" role="alert">${problem.message}</p>`}
  </form>`;
}
