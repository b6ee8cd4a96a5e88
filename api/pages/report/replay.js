/** The replay in a report: one file on somebody's disk, which holds these modules, the scene and the poses. */

import { html, render, useState } from "../lib/html.js";
import { readReplay } from "../lib/replay/file.js";
import { readScene } from "../lib/replay/scene.js";
import { Stage } from "../lib/replay/stage.js";
import { Player } from "../parts/replay/player.js";

const MOST_AT_ONCE = 8;

/** The bytes that the report holds under a name, in base64. */
function held(name) {
  const binary = atob(document.getElementById(name).textContent);
  return Uint8Array.from(binary, (character) => character.charCodeAt(0)).buffer;
}

async function load() {
  const poses = held("replay-poses");
  const replay = await readReplay(async (first, last) => poses.slice(first, last + 1));
  return { scene: await readScene(held("replay-scene")), replay };
}

function Replay({ scene, replay, first }) {
  const [shown, setShown] = useState({ scene, about: replay.about, episodes: [first], isBeside: false, key: "0" });
  const [options, setOptions] = useState({ follow: true, contacts: false, shadows: null, speed: 1 });
  const choose = async (event) => {
    const chosen = Number(event.target.value);
    const numbers = chosen < 0 ? replay.about.episodes.slice(0, MOST_AT_ONCE).map((_, number) => number) : [chosen];
    const episodes = await Promise.all(numbers.map(replay.episode));
    setShown({ ...shown, episodes, isBeside: chosen < 0, key: String(chosen) });
  };
  const all = replay.about.episodes;
  return html`<${Player} Stage=${Stage} shown=${shown} start=${null} name="Replay" options=${options}
    setOption=${(name, value) => setOptions({ ...options, [name]: value })} onPause=${() => {}}>
    ${all.length > 1 &&
    html`<label>Episode
      <select value=${shown.key} onChange=${choose}>
        ${all.map((_, number) => html`<option value=${number}>${number + 1}</option>`)}
        <option value="-1">${all.length > MOST_AT_ONCE ? `The first ${MOST_AT_ONCE}` : "All"}, side by side</option>
      </select>
    </label>`}
  <//>`;
}

const place = document.getElementById("replay");
load()
  .then(async ({ scene, replay }) => {
    const first = await replay.episode(0);
    render(html`<${Replay} scene=${scene} replay=${replay} first=${first} />`, place);
  })
  .catch((error) => (place.textContent = `The replay cannot be shown: ${error.message}`));
