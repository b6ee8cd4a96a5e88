/** A job's policy at work in the browser, to be pushed (docs/push.md). */

import { get, send } from "../../lib/api.js";
import { html } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { Pusher } from "../../parts/replay/pusher.js";
import { Empty, Loading } from "../../parts/states.js";
import { canPush, replaysOf } from "./replay.js";

export function PushTab({ job }) {
  const { data, error, again } = useLive((signal) => load(job, signal), [job.id, canPush(job)]);
  if (error) return html`<${Empty}><p>${error.message}</p><p><button type="button" onClick=${again}>Try again</button></p><//>`;
  if (!data) return html`<${Loading} what="the body" />`;
  if (data.refusal) return html`<${Empty}><p>${data.refusal}</p><//>`;
  return html`<section class="card" aria-label="Push">
    <${Pusher} modules=${data.modules} shown=${data.shown} name="The trained body" />
  </section>`;
}

async function load(job, signal) {
  const recipe = await get(`/jobs/${job.id}/simulation`, {}, { signal });
  if (recipe.refusal) return recipe;
  const replay = replaysOf(job).at(-1);
  if (!replay) return { refusal: "This job has no replay, which has the body's looks: its video is null, or its log says why." };
  // three.js and what uses it are loaded here; MuJoCo by the worker.
  const [{ Stage }, { loadScene, openReplay }, { Handle }, physics] = await Promise.all([
    import("../../lib/replay/stage.js"),
    import("../../lib/replay/fetching.js"),
    import("../../lib/push/handle.js"),
    import("../../lib/push/body.js"),
  ]);
  const [scene, { about }, policy] = await Promise.all([
    loadScene(`/jobs/${job.id}/replay/scene`),
    openReplay(replay.href, signal),
    send(`/jobs/${job.id}/policy?format=numpy`, { signal }).then((answer) => answer.arrayBuffer()),
  ]);
  return { modules: { Stage, Handle, ...physics }, shown: { scene, about, recipe, policy } };
}
