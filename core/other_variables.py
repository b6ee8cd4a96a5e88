"""Variables that no settings class holds: the page on settings lists them beside those that one does."""

from dataclasses import dataclass

SECRETS_DIR = "GAITWAY_SECRETS_DIR"


@dataclass(frozen=True)
class Other:
    """readers: the process, program or tool that looks at it."""

    name: str
    readers: str
    default: str
    meaning: str


OTHERS = (
    Other(SECRETS_DIR, "API, worker, reconciler", "–", "Folder of files that hold settings, one each."),
    Other("GAITWAY_URL", "`gaitway`, `gaitway.Client`", "`http://127.0.0.1:8000`", "Where the API is."),
    Other(
        "GAITWAY_ADDRESS",
        "Docker Compose",
        "`127.0.0.1`",
        "Address of this host that the API is published at.",
    ),
    Other("GAITWAY_PORT", "Docker Compose", "`8000`", "Port of this host that the API is published at."),
    Other(
        "GAITWAY_SHARE",
        "Docker Compose",
        "–",
        "Address of this host at which workers elsewhere reach its stores; with deploy/share.yml.",
    ),
    Other("GAITWAY_GPUS", "Docker Compose", "`all`", "How many GPUs the profile `gpu` takes."),
    Other("GAITWAY_IMAGE", "Docker Compose", "`gaitway`", "What the images' names begin with."),
    Other("GAITWAY_TAG", "Docker Compose", "`latest`", "The images' tag."),
    Other(
        "SSL_CERT_FILE",
        "API, worker, reconciler",
        "the system's",
        "Certificates to trust, in one PEM file, where the stores' TLS has an authority of your own.",
    ),
    Other(
        "MUJOCO_GL",
        "worker",
        "`egl`, else `osmesa`",
        "The OpenGL back-end that draws videos: `egl`, `osmesa` or `glfw`.",
    ),
    Other(
        "MUJOCO_EGL_DEVICE_ID",
        "worker",
        "the job's GPU",
        "Which EGL device draws, where EGL and CUDA number the GPUs differently.",
    ),
)
