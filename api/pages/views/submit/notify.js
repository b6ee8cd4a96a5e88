/** Which webhooks are told of a job, whatever jobs they are for: a choice among those of its project. */

import { get } from "../../lib/api.js";
import { html } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { href } from "../../lib/route.js";
import { isAdmin } from "../../lib/session.js";
import { Wrong, errorsAt, errorsBelow, Field } from "../../parts/field.js";
import { useProjects } from "../../parts/whose.js";

const PATH = ["notify"];

/** project: what the document says. document, set, errors, schema: as of a `Field`. */
export function Notify({ project, ...field }) {
  const { document, set, errors, schema } = field;
  const projects = useProjects();
  const own = project || (!isAdmin() && projects.length === 1 && projects[0]) || "default";
  const { data } = useLive((signal) => get(`/projects/${encodeURIComponent(own)}/webhooks`, {}, { signal }), [own]);
  if (!data) return html`<${Field} ...${field} path=${PATH} />`; // Names can be typed meanwhile.
  const said = Array.isArray(document.notify) ? document.notify : [];
  // One that is gone stays to be unticked.
  const names = [...new Set([...data.items.map(({ name }) => name), ...said])];
  const tick = (name) => () => {
    const next = names.filter((one) => said.includes(one) !== (one === name));
    set(PATH, next.length ? next : undefined);
  };
  return html`<div class="field"><span class="label-like" id="notify-label">notify</span>
    ${names.length > 0 && html`<div class="ticks" role="group" aria-labelledby="notify-label" aria-describedby="notify-about">
      ${names.map((name) => html`<label class="tick" key=${name}><input type="checkbox" checked=${said.includes(name)} onChange=${tick(name)} /> ${name}</label>`)}
    </div>`}
    <p class="facts" id="notify-about">${names.length ? schema.description : html`The project ${own} has no webhooks; <a href=${href(["news"], { project: own })}>News</a> adds them.`}</p>
    <${Wrong} errors=${[...errorsAt(errors, PATH), ...errorsBelow(errors, PATH)]} />
  </div>`;
}
