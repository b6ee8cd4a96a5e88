/** A body under its policy, stepped by MuJoCo as `simulation.json` says (docs/push.md). Uses nothing of the page. */

import { firstLayout } from "./terrain.js";
import { Task } from "./task.js";

// Of the spring that pulls a body, as in MuJoCo's own viewer: for each kg that the body has where it is held.
// The camera goes along with a body that runs, so a critical damping would brake it more than the spring pulls.
const STIFFNESS = 100; // N/m
const DAMPING = 0.4 * Math.sqrt(STIFFNESS); // N s/m: a fifth of critical
const MOST = 5; // times the weight of the whole
const CALM_S = 0.3; // Over which the measured velocity is averaged: a step of a foot sways the body.

export class Simulation {
  /** @param {object} mujoco The loaded module. @param {object} recipe `simulation.json`. Raises Error if MuJoCo cannot read the model. */
  constructor(mujoco, recipe, policy) {
    if (recipe.format !== "gaitway-simulation" || recipe.version > 2) throw new Error("This file is not a simulation that the page knows.");
    if (recipe.version < 2) throw new Error("An older version of the service wrote this simulation: train the job again to push its body.");
    this.mujoco = mujoco;
    this.recipe = recipe;
    this.setPolicy(policy);
    this.model = mujoco.MjModel.from_xml_string(recipe.model);
    this.data = new mujoco.MjData(this.model);
    this.mass = this.model.body_mass.reduce((sum, mass) => sum + mass, 0);
    this.weight = this.mass * Math.hypot(...this.model.opt.gravity);
    this.task = new Task(recipe, this.data);
    this.command = (recipe.command || []).map(() => 0);
    if (recipe.terrain) this.setLayout(firstLayout(recipe.terrain));
    this.reset();
  }

  /** Put this one of `recipe.terrain.layouts` about the start; an episode has to begin afterwards. */
  setLayout(number) {
    const { geoms, layouts } = this.recipe.terrain;
    for (const [name, rows] of Object.entries(layouts[number].model)) {
      const width = rows.length / geoms.length;
      geoms.forEach((geom, row) => this.model[name].set(rows.slice(row * width, (row + 1) * width), geom * width));
    }
    this.task.setLayout(layouts[number]);
  }

  get time() {
    return this.data.time;
  }

  /** From the next action on, this one acts. */
  setPolicy(policy) {
    this.policy = policy;
    this.held = policy.about.action.held_steps;
  }

  /** What the policy is told to do: a number for each of `recipe.command`. */
  setCommand(command) {
    this.command = command;
  }

  /** Begin an episode. random: gives numbers in [0, 1). */
  reset(random = Math.random) {
    this.mujoco.mj_resetData(this.model, this.data);
    this.task.place(random);
    this.begin();
  }

  /** Begin with the positions and velocities that `data` has. */
  begin() {
    this.mujoco.mj_forward(this.model, this.data);
    this.action = new Float64Array(this.model.nu);
    this.substep = 0;
    this.hasEnded = false;
    this.motion = this.command.map(() => 0);
    this.observation = this.task.begin(this.command);
    this.setPull(null);
  }

  /** Move by one time step of the model; at the beginning of each action the policy is asked. */
  step() {
    const { num_substeps: numSubsteps } = this.recipe;
    if (this.isBetweenActions) {
      if (this.substep % (numSubsteps * this.held) === 0) this.action = this.policy.act(this.observation);
      this.data.ctrl.set(this.task.control(this.action, this.command));
    }
    this.#apply();
    this.mujoco.mj_step(this.model, this.data);
    this.substep += 1;
    if (!this.isBetweenActions) return;
    // As after an environment's step: what MuJoCo derives describes the state that is reached.
    this.#derive();
    const { observation, ended } = this.task.after(this.action, this.command);
    Object.assign(this, { observation, hasEnded: ended });
    this.#measure();
  }

  /** Whether an action has just ended, when episodes may end. */
  get isBetweenActions() {
    return this.substep % this.recipe.num_substeps === 0;
  }

  /**
   * Pull a body until told otherwise; null: no more.
   * @param {{body: number, point: number[], to: number[]} | {body: number, force: number[]} | null} pull
   *   point: where it is held, [3] in the body's frame; to: [3] in the world. Or force: [3], in times the weight.
   */
  setPull(pull) {
    if (pull?.body !== this.pull?.body) this.heldAt = null;
    this.pull = pull;
  }

  /** Poses of all bodies: positions [3 × nbody], quaternions [4 × nbody]. */
  poses() {
    this.mujoco.mj_kinematics(this.model, this.data);
    return { positions: Float32Array.from(this.data.xpos), rotations: Float32Array.from(this.data.xquat) };
  }

  #derive() {
    for (const stage of ["mj_fwdPosition", "mj_sensorPos", "mj_fwdVelocity", "mj_sensorVel"]) this.mujoco[stage](this.model, this.data);
  }

  /** The velocity that a command is about, in the root's own frame: forward and left in m/s, turn in rad/s. */
  #measure() {
    const { data, model, recipe } = this;
    if (!this.command.length) return;
    const body = recipe.tracked_body;
    const turn = data.xmat.subarray(9 * body, 9 * body + 9);
    const [x, y, z, , , spin] = data.qvel.subarray(model.body_dofadr[body], model.body_dofadr[body] + 6);
    const now = [turn[0] * x + turn[3] * y + turn[6] * z, turn[1] * x + turn[4] * y + turn[7] * z, spin];
    const share = 1 - Math.exp((-recipe.num_substeps * model.opt.timestep) / CALM_S);
    this.motion = this.motion.map((part, i) => part + share * ((now[i] ?? 0) - part));
  }

  /** The pull as MuJoCo's applied force: at the body's centre of mass, with the torque about it. */
  #apply() {
    const { data, pull } = this;
    const applied = data.xfrc_applied;
    applied.fill(0);
    this.force = null;
    if (!pull) return;
    const { body } = pull;
    const vector = (values) => Array.from(values.subarray(3 * body, 3 * body + 3));
    const centre = vector(data.xipos);
    let at = centre;
    let force;
    if (pull.force) force = pull.force.map((part) => part * this.weight);
    else {
      const turn = data.xmat.subarray(9 * body, 9 * body + 9);
      const arm = [0, 1, 2].map((row) => turn[3 * row] * pull.point[0] + turn[3 * row + 1] * pull.point[1] + turn[3 * row + 2] * pull.point[2]);
      at = vector(data.xpos).map((part, i) => part + arm[i]);
      const before = this.heldAt || at;
      const mass = 1 / this.model.body_invweight0[2 * body];
      const { timestep } = this.model.opt;
      force = at.map((part, i) => mass * (STIFFNESS * (pull.to[i] - part) - (DAMPING * (part - before[i])) / timestep));
      const tooMuch = Math.hypot(...force) / (MOST * this.weight);
      if (tooMuch > 1) force = force.map((part) => part / tooMuch);
      this.heldAt = at;
    }
    this.force = { at, force };
    applied.set([...force, ...cross(at.map((part, i) => part - centre[i]), force)], 6 * body);
  }
}

const cross = ([ax, ay, az], [bx, by, bz]) => [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
