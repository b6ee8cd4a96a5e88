"""A training job: the trainer's events become messages and files."""

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace

import jax

from core.algorithms.ppo.networks import PolicyParams
from core.algorithms.ppo.policy import make_inference, policy_from_checkpoint
from core.algorithms.ppo.spec import PPOSpec, resolve
from core.algorithms.ppo.trainer import PPOTrainer
from core.algorithms.trainer import CheckpointReady, Evaluated, Event, Phase, Progress, ShowsTables, Trainer
from core.environments.action_repeat import repeat_action
from core.errors import JobFailed
from core.jobs.spec import TrainSpec
from worker.messages import Advanced, Measured, Noted, PhaseEnded, Task
from worker.training.body import Body
from worker.training.channel import Channel
from worker.training.pictures import kept_with_tables
from worker.training.stopping import Stopping
from worker.training.video import Film

# A tenth of the budget lies between checkpoints where the job does not say.
_CHECKPOINTS = 10


def train(task: Task, spec: TrainSpec, body: Body, channel: Channel, stopping: Stopping) -> bool:
    """Train to the end or to a stop; whether a stop cut it short.

    Keeps a checkpoint; and where the job does not go on elsewhere, its policy and a video.
    """
    settings = resolve(spec.algorithm, body.info, body.device)
    channel.send(body.started(hyperparameters=settings.model_dump(), resumed_at_step=task.checkpoint_step))
    trainer = make_trainer(task, spec, settings, body, channel)
    report = Report(channel, trainer, settings)
    shown = replace(body, environment=repeat_action(body.environment, settings.action_repeat))
    film = Film(spec, shown, _act, channel)
    try:
        for event in trainer.events():
            if isinstance(event, Progress):
                stopping.keep_before_leaving()
            report.tell(event)
            if stopping.asked:
                break
            if isinstance(event, CheckpointReady) and spec.video.every_checkpoint:
                with stopping.nothing_to_keep():
                    film.shoot(f"video-{event.step:012d}", _policy(trainer), event.step)
    except JobFailed:
        report.keep_checkpoint()  # The last good one.
        raise
    report.keep_checkpoint()
    with stopping.nothing_to_keep():
        channel.keep("policy", trainer.policy(), "policy", "application/octet-stream", step=trainer.step)
        with _tables(trainer, spec, channel):
            film.shoot("video", _policy(trainer), trainer.step)
    return stopping.asked and trainer.step < settings.num_timesteps


def _tables(trainer: Trainer, spec: TrainSpec, channel: Channel) -> AbstractContextManager[None]:
    """Keeps what the trainer shows of itself, if it does; drawn while the block runs."""
    if not isinstance(trainer, ShowsTables):
        return nullcontext()
    return kept_with_tables(channel, trainer.tables(), trainer.step, spec.environment.id)


def _policy(trainer: Trainer) -> PolicyParams:
    return policy_from_checkpoint(trainer.checkpoint())


def _act(parameters: PolicyParams, observation: jax.Array, key: jax.Array) -> jax.Array:
    return make_inference(parameters)(observation, key)


def make_trainer(task: Task, spec: TrainSpec, settings: PPOSpec, body: Body, channel: Channel) -> Trainer:
    """The trainer that the algorithm's kind names, set up to go on from the task's checkpoint."""
    resume = (channel.spool / task.checkpoint).read_bytes() if task.checkpoint else None
    every_steps = spec.checkpoints.every_steps or max(1, settings.num_timesteps // _CHECKPOINTS)
    return PPOTrainer(
        body.environment,
        settings,
        seed=spec.seed,
        checkpoint_every_steps=every_steps,
        resume=resume,
        devices=body.num_devices,
    )


@dataclass
class Report:
    """Turns a trainer's events into messages; remembers the newest metrics, and the last checkpoint kept."""

    channel: Channel
    trainer: Trainer
    settings: PPOSpec
    _metrics: dict[str, float] = field(default_factory=dict[str, float])
    _kept_step: int | None = None
    _warned: bool = False
    _started: tuple[float, int] = (0.0, 0)

    def tell(self, event: Event) -> None:
        match event:
            case Phase(name=name, seconds=seconds):
                self.channel.send(PhaseEnded(name=name, seconds=seconds))
            case Progress(step=step, total=total, metrics=metrics):
                self._metrics.update(metrics)
                self._warn_of_overflow(step, metrics)
                self.channel.send(Measured(step=step, values=dict(metrics)))
                self.channel.send(self._advanced(step, total))
            case Evaluated(step=step, metrics=metrics):
                self._metrics.update(metrics)
                self.channel.send(Measured(step=step, values=dict(metrics)))
                # The last update may pass the budget, as in Brax: that is where the run ends.
                total = self.settings.num_updates * self.settings.env_steps_per_update
                self.channel.send(self._advanced(step, total))
            case CheckpointReady():
                self.keep_checkpoint()

    def keep_checkpoint(self) -> None:
        """Of the present state, once."""
        step = self.trainer.step
        if step != self._kept_step:
            name = f"checkpoint-{step:012d}.msgpack"
            self.channel.keep(name, self.trainer.checkpoint(), "checkpoint", "application/msgpack", step=step)
            self._kept_step = step

    def _warn_of_overflow(self, step: int, metrics: Mapping[str, float]) -> None:
        """Once; how often it happens from then on is a metric."""
        if metrics.get("training/physics_overflow", 0.0) > 0 and not self._warned:
            self._warned = True
            self.channel.send(
                Noted(
                    text=f"By step {step}, the engine's buffers were too small for some worlds, and contacts "
                    "were lost (training/physics_overflow is the share of steps). Ask for another engine "
                    "by `physics` if that matters."
                )
            )

    def _advanced(self, step: int, total: int) -> Advanced:
        now = time.monotonic()
        if self._started == (0.0, 0):
            self._started = (now, step)
        began, first_step = self._started
        rate = (step - first_step) / (now - began) if step > first_step else self._metrics.get("training/sps")
        eta_s = max(0, total - step) / rate if rate else None
        return Advanced(
            step=step, total=total, steps_per_second=rate, eta_s=eta_s, metrics=dict(self._metrics)
        )
