/** Whose things are, where the service has accounts: as text, as filters of a list, as a choice for what is new. */

import { get } from "../lib/api.js";
import { html } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { change } from "../lib/route.js";
import { isAdmin, session } from "../lib/session.js";

/** A part of a line of facts: ` · ann · gaits`; empty without accounts. */
export const whose = ({ owner, project }) => (session().accounts ? ` · ${owner ?? "nobody’s"} · ${project}` : "");

/** The projects that one may submit to; none before they are known, and without accounts. */
export function useProjects() {
  const { data } = useLive(async (signal) => (isAdmin() ? (await get("/projects", {}, { signal })).items.map(({ name }) => name) : session().who?.projects), []);
  return (session().accounts && data) || [];
}

export const WHOSE = ["owner", "project"];

/** asked: lists of values by filter, as the address has them. */
export function WhoseFilters({ asked }) {
  const projects = useProjects();
  if (!session().accounts) return null;
  const set = (name) => ({ target }) => change({ [name]: target.value.trim(), cursor: [] });
  return html`
    <label>Owner <input type="search" list="owners" value=${asked.owner[0] || ""} onChange=${set("owner")} placeholder="anybody" /></label>
    <datalist id="owners"><option value=${session().who.user}></option></datalist>
    <label>Project
      <select value=${asked.project[0] || ""} onChange=${set("project")}>
        <option value="">any</option>
        ${projects.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}
      </select>
    </label>`;
}

/** Where something new belongs; nothing to choose with one project. errors: of the form that it is in. */
export function ProjectChoice({ value, onChange, errors = [] }) {
  const projects = useProjects();
  if (projects.length < 2) return null;
  const wrong = errors.filter(({ pointer }) => pointer === "/project");
  return html`<div class="field">
    <label for="project">project</label>
    <select id="project" value=${value || ""} onChange=${({ target }) => onChange(target.value || undefined)} aria-describedby="project-about" aria-invalid=${wrong.length ? "true" : undefined}>
      <option value="">${isAdmin() ? "default: default" : "choose one"}</option>
      ${projects.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}
    </select>
    <p class="facts" id="project-about">Its members see it.</p>
    ${wrong.map(({ detail }) => html`<p class="error">${detail}</p>`)}
  </div>`;
}
