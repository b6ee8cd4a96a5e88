/** The users' models, one of which a job of `mjcf` trains. */

import { get } from "../../lib/api.js";
import { ago } from "../../lib/format.js";
import { html, useId } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { nameOf } from "../../lib/models.js";
import { href } from "../../lib/route.js";
import { Failure, Loading } from "../../parts/states.js";

const LIMIT = 100;

/** chosen: a model's id, if any; choose: gets the next one. */
export function OwnModels({ chosen, choose }) {
  const id = useId();
  const { data, error, again } = useLive((signal) => get("/models", { limit: LIMIT }, { signal }), []);
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="models" />`;
  const ready = data.items.filter(({ status }) => status === "ready");
  if (!ready.length) return html`<p class="facts">No model is ready: <a href=${href(["models"])}>send one</a>, and choose it here.</p>`;
  return html`<label for=${id}>Model</label>
    <select id=${id} value=${chosen || ""} onChange=${({ target }) => choose(target.value || undefined)}>
      <option value="">choose one</option>
      ${ready.map((model) => html`<option value=${model.id}>${`${nameOf(model)} · ${model.id.slice(7, 15)} · ${ago(model.created_at)}`}</option>`)}
    </select>
    ${data.next && html`<p class="facts">These are among the newest ${LIMIT}; <a href=${href(["models"])}>older ones</a> have a button there.</p>`}`;
}
