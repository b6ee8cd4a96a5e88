/** A body under its policy, stepped by MuJoCo as `simulation.json` says (docs/push.md). Uses nothing of the page. */

// Of the spring that pulls a body, as in MuJoCo's own viewer: for each kg that the body has where it is held.
// The camera goes along with a body that runs, so a critical damping would brake it more than the spring pulls.
const STIFFNESS = 100; // N/m
const DAMPING = 0.4 * Math.sqrt(STIFFNESS); // N s/m: a fifth of critical
const MOST = 5; // times the weight of the whole
const NUM_AHEAD = 10; // obstacles of a corridor

export class Simulation {
  /** @param {object} mujoco The loaded module. @param {object} recipe `simulation.json`. Raises Error if MuJoCo cannot read the model. */
  constructor(mujoco, recipe, policy) {
    if (recipe.format !== "gaitway-simulation" || recipe.version !== 1) throw new Error("This file is not a simulation that the page knows.");
    this.mujoco = mujoco;
    this.recipe = recipe;
    this.setPolicy(policy);
    this.model = mujoco.MjModel.from_xml_string(recipe.model);
    this.data = new mujoco.MjData(this.model);
    this.mass = this.model.body_mass.reduce((sum, mass) => sum + mass, 0);
    this.weight = this.mass * Math.hypot(...this.model.opt.gravity);
    this.reset();
  }

  get time() {
    return this.data.time;
  }

  /** From the next action on, this one acts. */
  setPolicy(policy) {
    this.policy = policy;
    this.held = policy.about.action.held_steps;
  }

  /** Begin an episode. random: numbers in [0, 1); () => 0.5 begins without noise. */
  reset(random = Math.random) {
    const { mujoco, model, data } = this;
    const { qpos, qvel = [], act = [], noise } = this.recipe;
    const even = (scale) => scale * (2 * random() - 1);
    const normal = (scale) => scale * Math.sqrt(-2 * Math.log(1 - random())) * Math.cos(2 * Math.PI * random());
    mujoco.mj_resetData(model, data);
    data.qpos.set(qpos.map((value) => value + even(noise.position)));
    const jolt = () => (noise.is_normal ? normal(noise.velocity) : even(noise.velocity));
    data.qvel.set(Array.from(data.qvel, (_, place) => (qvel[place] ?? 0) + jolt()));
    if (act.length) data.act.set(act);
    this.begin();
  }

  /** Begin with the positions and velocities that `data` has. */
  begin() {
    this.mujoco.mj_forward(this.model, this.data);
    this.action = new Float64Array(this.model.nu);
    this.substep = 0;
    this.setPull(null);
  }

  /** Move by one time step of the model; at the beginning of each action the policy is asked. */
  step() {
    const { num_substeps: numSubsteps, control_offset: offset, control_gain: gain } = this.recipe;
    if (this.substep % (numSubsteps * this.held) === 0) {
      this.action = this.policy.act(this.observe());
      this.data.ctrl.set(this.action.map((value, i) => offset[i] + gain[i] * value));
    }
    this.#apply();
    this.mujoco.mj_step(this.model, this.data);
    this.substep += 1;
    // As after an environment's step: what MuJoCo derives describes the state that is reached.
    if (this.substep % numSubsteps === 0) this.#derive();
  }

  /** Whether an action has just ended, when episodes may end. */
  get isBetweenActions() {
    return this.substep % this.recipe.num_substeps === 0;
  }

  observe() {
    return this.recipe.observation.flatMap((numbers) => this.#read(numbers));
  }

  /** Whether the episode would end here. */
  hasEnded() {
    return this.recipe.ends.some(({ numbers, low, high }) =>
      this.#read(numbers).some((value) => value < (low ?? -Infinity) || value > (high ?? Infinity) || Number.isNaN(value)),
    );
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

  #read({ array, places, less, add, max_abs: most }) {
    const values = this.#array(array);
    return places.map((place, i) => {
      const value = values[place] + add - (less.length ? values[less[i]] : 0);
      return most === null ? value : Math.min(Math.max(value, -most), most);
    });
  }

  #array(name) {
    if (name === "previous_action") return this.action;
    if (name === "obstacles_ahead") return this.#ahead();
    if (name === "share_velocity") return this.#shares();
    return this.data[name];
  }

  /** Of each next obstacle, how far ahead it begins and ends and how far to the left the way past it is. */
  #ahead() {
    const { obstacles, sight } = this.recipe;
    const [x, y] = this.data.qpos;
    const coming = obstacles.filter(([, end]) => end >= x).slice(0, NUM_AHEAD);
    const seen = coming.map(([begin, end, middle]) => [Math.min(begin - x, sight), Math.min(end - x, sight), begin - x < sight ? middle - y : 0]);
    while (seen.length < NUM_AHEAD) seen.push([sight, sight, 0]);
    return seen.flat();
  }

  #shares() {
    const { cinert, cvel } = this.data;
    const shares = [];
    for (let body = 0; body < this.model.nbody; body++) {
      const [ax, ay, az, vx, vy, vz] = cvel.subarray(6 * body, 6 * body + 6);
      const [mx, my, mz, mass] = cinert.subarray(10 * body + 6, 10 * body + 10);
      // The velocity at the body's own centre of mass, by its share of all masses.
      const [ox, oy, oz] = cross([ax, ay, az], [mx, my, mz]);
      shares.push((mass * vx + ox) / this.mass, (mass * vy + oy) / this.mass, (mass * vz + oz) / this.mass, ax, ay, az);
    }
    return shares;
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
