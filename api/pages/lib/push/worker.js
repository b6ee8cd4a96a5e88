/**
 * Steps a body in real time, beside the page: MuJoCo's WebAssembly is allowed by this file's own
 * Content-Security-Policy alone.
 *
 * It hears {open: {recipe, policy}}, then {policy} in its place, {pull}, {command: numbers}, {layout: number}, {reset: true}, {run: boolean}.
 * It says {failure}, or after each picture's time {time, positions, rotations, force, weight, motion, command, isSlow}; {fell: seconds} once an
 * episode has ended; and {trainedSteps} of the policy that acts.
 */

import loadMujoco from "../../vendor/mujoco.js";
import { readPolicy } from "./policy.js";
import { Simulation } from "./simulation.js";

const PICTURE_MS = 1000 / 60;
const MOST_BEHIND_S = 0.1; // What a slow machine cannot catch up is dropped.
const LIE_S = 1.5; // How long a fallen body is seen before it starts again.

let simulation = null;
let isRunning = false;
let last = 0;
let behind = 0;
let fallenUntil = null;

async function open({ recipe, policy }) {
  const mujoco = await loadMujoco();
  try {
    simulation = new Simulation(mujoco, recipe, readPolicy(policy));
  } catch (error) {
    const version = mujoco.mj_versionString();
    throw new Error(`MuJoCo ${version}, which the page has, cannot run this model of MuJoCo ${recipe.mujoco}: ${error.message || error}`);
  }
  tell();
  tellPolicy();
}

const tellPolicy = () => postMessage({ trainedSteps: simulation.policy.about.trained_steps });

function reset() {
  fallenUntil = null;
  simulation.reset();
  tell();
}

function advance() {
  if (!isRunning || !simulation) return;
  const now = performance.now();
  behind += (now - last) / 1000;
  last = now;
  const isSlow = behind > MOST_BEHIND_S;
  if (isSlow) behind = MOST_BEHIND_S;
  const { timestep } = simulation.model.opt;
  for (; behind >= timestep; behind -= timestep) {
    simulation.step();
    if (fallenUntil === null && simulation.isBetweenActions && simulation.hasEnded) {
      postMessage({ fell: simulation.time });
      fallenUntil = simulation.time + LIE_S;
    }
    if (fallenUntil !== null && !(simulation.time < fallenUntil)) reset();
  }
  tell(isSlow);
}

function tell(isSlow = false) {
  const { positions, rotations } = simulation.poses();
  const { force, weight, motion, command } = simulation;
  postMessage({ time: simulation.time, positions, rotations, force, weight, motion, command, isSlow }, [positions.buffer, rotations.buffer]);
}

onmessage = async ({ data: said }) => {
  try {
    if (said.open) await open(said.open);
    if (said.policy) {
      simulation.setPolicy(readPolicy(said.policy));
      tellPolicy();
    }
    if (said.pull !== undefined) simulation.setPull(said.pull);
    if (said.command) simulation?.setCommand(said.command);
    if (said.layout !== undefined) simulation.setLayout(said.layout);
    if (said.reset) reset();
    if (said.run !== undefined) {
      isRunning = said.run;
      last = performance.now();
    }
  } catch (error) {
    postMessage({ failure: error.message || String(error) });
  }
};
setInterval(advance, PICTURE_MS);
