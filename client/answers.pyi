"""The types of openapi.yaml's requests and answers. `python -m client.write_answers` writes this file."""

from typing import Any, Literal, NotRequired, TypedDict

class AdaptiveAttack(TypedDict):
    """An attack on pixels that knows the re-rendering defence (BPDA)."""
    fooled: bool
    steps: int
    goal_probability: list[float]
    image: Said
    rerendered: Said
    perceptibility: float

class AdaptiveRequest(TypedDict):
    """An attack on the original image's pixels that knows the re-rendering defence; each step needs a fit."""
    steps: NotRequired[int]
    fit: NotRequired[RerenderingRequest]

class Analyses(TypedDict):
    """The analyses that the request asked for; null for those that it did not name."""
    coordinates: NotRequired[Attribution | None]
    minimal: NotRequired[MinimalChange | None]
    transfer: NotRequired[list[Transferred] | None]
    interpretation: NotRequired[Interpretation | None]
    rerendering: NotRequired[Rerendering | None]
    adaptive: NotRequired[AdaptiveAttack | None]

class AnalysisRequest(TypedDict):
    """The analyses of the stored perturbation to make after the attack. Each is left out unless it is named; {}
    gives its defaults. Perceptibility, the table of subsets and the groups' Shapley values are in every result.
    """
    coordinates: NotRequired[CoordinatesRequest | None]
    minimal: NotRequired[MinimalRequest | None]
    transfer: NotRequired[TransferRequest | None]
    interpretation: NotRequired[InterpretationRequest | None]
    rerendering: NotRequired[RerenderingRequest | None]
    adaptive: NotRequired[AdaptiveRequest | None]

class Answer(TypedDict):
    """The network's answer to one image, rounded to 8 bits."""
    label: str
    index: int
    confidence: float
    goal_probability: float
    top: list[list[str | float]]

class Apgd(TypedDict):
    """Auto-PGD (Croce & Hein 2020): sign steps within ε with momentum; at checkpoints the step is halved and the
    best point taken up again if too few steps improved the objective. It has no step size to choose: steps are
    measured in ε, which each group therefore has, whatever else limits the perturbation.
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['apgd']]
    steps: NotRequired[int]
    loss: NotRequired[Literal['log-odds', 'margin', 'dlr']]
    masking_queries: NotRequired[int]

class ArtifactList(TypedDict):
    """The files of a job that has ended, or the checkpoint from which it is to go on."""
    items: list[ArtifactView]

class ArtifactView(TypedDict):
    """A file of a finished job."""
    name: str
    sha256: str
    media_type: str
    size: int

class Asked(TypedDict):
    """A question about an image, and its right answer."""
    question: str | None
    program: list[dict[str, Any]]
    kind: str
    right: str

class AssetList(TypedDict):
    """Uploaded meshes and environment maps."""
    items: list[Uploaded]

class AssetUpload(TypedDict):
    """A mesh or an environment map, with what is said of it."""
    file: list[str]
    kind: NotRequired[str | None]
    mesh: NotRequired[str | None]
    name: NotRequired[str | None]
    up: NotRequired[Literal['y', 'z'] | None]
    licence: NotRequired[str | None]
    credit: NotRequired[str | None]

class AtEpsilon(TypedDict):
    """The values of a group that are at its ε."""
    coordinates: int
    share: float

class Attended(TypedDict):
    """The files that show what a function of a program attends to: grey images, white where an object of its set
    is.
    """
    node: int
    before: str
    after: str
    change: float
    cell_change: float

class Attribution(TypedDict):
    """Shapley values of a perturbation's parts: its groups, or single coordinates."""
    parts: list[str]
    method: Literal['exact', 'sampled']
    orders: NotRequired[int | None]
    images: int
    log_odds: Shares
    probability: Shares

class Background(TypedDict):
    """What is behind objects and floor, in place of the colour `ground`: the environment map, or a picture."""
    image: NotRequired[str | None]

class BadField(TypedDict):
    """A field of a request with an invalid value."""
    field: str
    detail: str

class Call(TypedDict):
    """A function of a question's program, as in CLEVR's question files; its generator's words for the fields count."""
    function: str
    inputs: NotRequired[list[int]]
    value_inputs: NotRequired[list[str]]

class Camera(TypedDict):
    """A camera on a sphere around the origin, looking at it, +y up."""
    azimuth: NotRequired[float]
    elevation: NotRequired[float]
    distance: NotRequired[float]
    field_of_view: NotRequired[float]
    size: NotRequired[list[int]]
    viewer: NotRequired[Literal['distant', 'perspective']]

class CameraRecord(TypedDict):
    """The camera of a scene made here: its position; it looks at the origin."""
    position: list[float]

class CampaignJobPage(TypedDict):
    """A page of a campaign's jobs, in the order in which they are queued."""
    items: list[CampaignJobView]
    next: int | None

class CampaignJobView(TypedDict):
    """A job that a campaign has planned."""
    number: int
    target: str
    attack: str
    view: int
    job: str | None
    state: State | None
    reused: bool
    outcome: Outcome | None

class CampaignPage(TypedDict):
    """A page of the list of campaigns, newest first."""
    items: list[CampaignSummary]
    next: str | None

class CampaignProgress(TypedDict):
    """How far a campaign is: first in views, then in jobs."""
    views: int
    answered: int
    jobs: int
    ended: int
    running: int

class CampaignResult(TypedDict):
    """The content of `table.json`: the table of the jobs that have ended, the mean curves, and all views."""
    table: Table
    curves: list[MeanCurves]
    views: list[ChosenView]

class CampaignSpec(TypedDict):
    """Many attacks that belong together: grids, single jobs, or both."""
    name: NotRequired[str]
    grids: NotRequired[list[Grid]]
    jobs: NotRequired[list[JobSpec]]
    reuse: NotRequired[bool]

CampaignState = Literal['selecting', 'running', 'paused', 'finished', 'failed', 'cancelled']

class CampaignSummary(TypedDict):
    """A campaign, as lists show it."""
    id: str
    name: str
    state: CampaignState
    created: str
    selected: str | None
    paused: str | None
    ended: str | None
    failure: str | None
    progress: CampaignProgress

class CampaignView(TypedDict):
    """A campaign with its request and its results so far."""
    id: str
    name: str
    state: CampaignState
    created: str
    selected: str | None
    paused: str | None
    ended: str | None
    failure: str | None
    progress: CampaignProgress
    spec: CampaignSpec | dict[str, Any]
    chosen: int
    outcomes: dict[str, int]
    successes: int
    reused: int
    seconds_left: float | None

class Cell(TypedDict):
    """All jobs of one attack on one target."""
    target: str
    attack: str
    jobs: int
    ended: int
    failed: int
    cancelled: int
    reused: int
    outcomes: dict[str, int]
    held_within_epsilon: NotRequired[int]
    success: Rate
    loop_success: Rate
    perceptibility: float | None
    loop_perceptibility: float | None
    truncated: float | None
    by_queries: list[list[float | int]]
    by_seconds: list[list[float | int]]
    by_p: NotRequired[list[list[float | int]]]
    most_queries: NotRequired[float | None]
    most_seconds: NotRequired[float | None]

class Change(TypedDict):
    """What an attack did to one thing in the scene: a sentence, and the numbers behind it."""
    group: str
    subject: str
    sentence: str
    values: list[ChangedValue]
    images: NotRequired[list[ChangeImage]]
    curves: NotRequired[list[Curve]]

class ChangeImage(TypedDict):
    """A file among a job's that shows a change."""
    file: str
    words: str

class ChangedValue(TypedDict):
    """A number of the scene before and after the attack."""
    name: str
    unit: str
    before: float
    after: float

class ChosenView(TypedDict):
    """A view of a campaign, and whether it is attacked."""
    number: int
    scene: str
    questions: NotRequired[list[str]]
    azimuth: float
    target: str
    renderer: str
    label: str | None
    confidence: float | None
    truth: list[str]
    right: bool
    chosen: bool
    why: str

class CmaEs(TypedDict):
    """Covariance matrix adaptation (Hansen 2016): each step draws a population around the mean, asks the network
    for each member, and moves mean and covariance towards the better half. It needs scores only.
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['cma-es']]
    steps: NotRequired[int]
    population: NotRequired[int | None]
    spread: NotRequired[dict[str, float]]

class Column(TypedDict):
    """An attack of a campaign, which is a column of its table."""
    name: str
    attack: Apgd | CmaEs | Fgsm | MiFgsm | NaturalGradient | PRgf | Spsa | Square | Zoo

class CoordinatesRequest(TypedDict):
    """Shapley values of single coordinates; groups without named coordinates (pixels, texels) count as a whole."""
    by: NotRequired[Literal['coordinate', 'object']]
    images: NotRequired[int]

class Cost(TypedDict):
    """What an attack costs, as far as it is known before. Both times were measured once, on this machine."""
    steps: int
    queries: int | None
    image_seconds: float
    query_seconds: float
    least_seconds: float

class Curve(TypedDict):
    """A quantity over an angle, before and after the attack."""
    name: str
    angles: list[float]
    before: list[float]
    after: list[float]

class DirectionalLight(TypedDict):
    """A light of the pyrender renderer at infinite distance, with parallel rays, like the sun."""
    energy: NotRequired[float]
    direction: NotRequired[list[float]]

class Entry(TypedDict):
    """An asset that a scene can name, with its attribution. `size` is width, depth and height in centimetres."""
    name: str
    title: str
    kind: Literal['furniture', 'primitive', 'upload', 'environment']
    category: str
    creator: str
    licence: str
    credit: str | None
    size: NotRequired[list[float] | None]
    triangles: NotRequired[int | None]
    used: NotRequired[list[str]]
    notes: NotRequired[list[str]]

class Environment(TypedDict):
    """A high-dynamic-range environment map: the light of the torch renderer."""
    map: NotRequired[str]
    size: NotRequired[list[int] | Literal['auto']]
    rotation: NotRequired[float]

class Expectation(TypedDict):
    """A range of views, light and camera noise over which the adversary is to hold (Athalye et al. 2018). Each step
    lowers the mean objective over the scene itself and `samples` variations of it, drawn anew. Each range is the
    half-width of a uniform distribution about the scene's own value, except `noise`.
    """
    azimuth: NotRequired[float]
    elevation: NotRequired[float]
    roll: NotRequired[float]
    distance: NotRequired[float]
    intensity: NotRequired[float]
    noise: NotRequired[float]
    samples: NotRequired[int]
    checks: NotRequired[int]

class Explanation(TypedDict):
    """One fit of physical parameters to an image."""
    optimiser: str
    rate: float
    losses: list[float]
    after: Said
    distance: float

class ExtensionView(TypedDict):
    """A file of SCENE_ATTACK_EXTENSIONS, as the service loaded it."""
    file: str
    sha256: str | None
    adds: list[str]
    error: str | None

class FailureView(TypedDict):
    """The reason for which a job failed."""
    kind: str
    detail: str

class Fgsm(TypedDict):
    """Iterative FGSM: steps along the gradient's sign, with momentum and weight decay of the perturbation (paper,
    section 3.2).
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['fgsm']]
    steps: NotRequired[int]
    learning_rate: NotRequired[dict[str, float]]
    momentum: NotRequired[float]
    weight_decay: NotRequired[float]

class FirstAnswer(TypedDict):
    """The network's answer to the scene before the attack."""
    question: str | None
    answer: Answer

class Floor(TypedDict):
    """A level square under the objects. It is no object: attacks neither move nor recolour it."""
    size: NotRequired[float]
    height: NotRequired[float]
    contact: NotRequired[bool]
    color: NotRequired[list[float]]
    material: NotRequired[str]
    metallic: NotRequired[float | None]
    roughness: NotRequired[float | None]

class Generate(TypedDict):
    """A scene after CLEVR for the generator to make."""
    seed: NotRequired[int]
    index: NotRequired[int]
    objects: NotRequired[int]

class Goal(TypedDict):
    """The answer that the attack wants from the network. A label is a name or an index.

    Non-targeted: the network must answer none of the labels in `leave`. Targeted: it must answer `reach`.
    `truth` says which answers are right; it decides the outcome, and which labels count as one answer.

    If `leave` is given, the network's answer to the original image must be among it. If it is left out, it is
    filled in: with the truth if that answer is right, else with that answer and the labels that mean the same.
    """
    truth: NotRequired[str | int | list[str | int] | None]
    leave: NotRequired[str | int | list[str | int] | None]
    reach: NotRequired[str | int | None]
    least_confidence: NotRequired[float]
    leave_kind: NotRequired[bool]

class GradientError(TypedDict):
    """Error of the gradient with respect to a group against the exact gradient, measured when the plan was made.

    The gradient is that of a sum of displayed values with normally distributed random weights. Of rasterised
    images it is made of central differences, whose exact values OpenGL's images have.
    """
    part: str
    group: str
    relative: float
    wrong_signs: float

class Grid(TypedDict):
    """All combinations of scenes, targets, attacks and seeds."""
    scenes: NotRequired[SceneGrid | list[Scene] | None]
    generate: NotRequired[QuestionGrid | None]
    targets: NotRequired[list[str | TargetChoice]]
    attacks: list[Column]
    seeds: NotRequired[list[int]]
    goal: NotRequired[Goal]
    tolerance: NotRequired[float | Literal['exact']]
    analysis: NotRequired[AnalysisRequest]
    selection: NotRequired[Selection]

class Health(TypedDict):
    """The answer of a process that is alive."""
    status: str

class HeldOver(TypedDict):
    """How the stored perturbation does over the range that its attack averaged over, on variations that no step of
    the attack has seen, each rendered by the exact path. Intervals are Wilson's of 95 %.
    """
    variations: int
    right: int
    fooled: int
    share: float | None
    interval: list[float] | None
    wrong_share: float
    wrong_interval: list[float]

class ImageError(TypedDict):
    """Mean absolute error of the displayed values of covered pixels, and the share of them off by more than 1/255."""
    mean: NotRequired[float]
    share: NotRequired[float]

class ImageOfScene(TypedDict):
    """An image: its bytes, or a file of a finished job."""
    data: NotRequired[str | None]
    job: NotRequired[str | None]
    artifact: NotRequired[str]

class Interpretation(TypedDict):
    """How well physical parameters explain the attacked image (paper, section 4.1.1)."""
    image: Said
    scene: Said
    fits: list[Explanation]

class InterpretationRequest(TypedDict):
    """Fits of normals, illumination and material to the attacked image: 3 learning rates times 2 optimisers."""
    steps: NotRequired[int]

class Item(TypedDict):
    """A quantity that an image is computed from: how many of it are kept, and why the others are left out."""
    part: NotRequired[str]
    what: str
    kept: int
    of: int
    why: str
    error: NotRequired[float]

class JobEdit(TypedDict):
    """Changes of what people have said about a job. Fields that are left out stay as they are."""
    title: NotRequired[str | None]
    tags: NotRequired[list[str] | None]
    note: NotRequired[str | None]

JobKind = Literal['attack', 'rerendering', 'selection']

class JobPage(TypedDict):
    """A page of the list of jobs."""
    items: list[JobSummary]
    next: str | None
    previous: NotRequired[str | None]

class JobPlan(TypedDict):
    """The renderer's plan of a job, with what limits its search, and its questions."""
    renderer: str
    groups: list[str]
    size: list[int]
    tolerance: float | Literal['exact']
    items: list[Item]
    stages: list[Stage]
    error: float
    error_is: NotRequired[Literal['maximum', 'mean']]
    gradients: NotRequired[list[GradientError]]
    environment_map_error: NotRequired[float | None]
    questions: NotRequired[list[Asked]]

class JobRow(TypedDict):
    """A line of the table of jobs. The fields from `outcome` to `seconds` are null until the job has succeeded."""
    id: str
    title: str | None
    name: str
    scene: str
    renderer: str
    method: str
    target: str
    question: str | None
    state: State
    outcome: str | None
    verified: bool | None
    before: str | None
    after: str | None
    p: float | None
    queries: int | None
    seconds: float | None
    seed: int
    tags: list[str]
    retry_of: str | None
    campaign: str | None
    created: str
    ended: str | None

class JobSpec(TypedDict):
    """One attack on one scene. Every field but the scene's objects has a default; the stored spec states all
    values.

    The scene may be given as CLEVR does, by `record` or `generate`; it is then filled in.
    """
    scene: NotRequired[Scene]
    record: NotRequired[SceneRecord | None]
    generate: NotRequired[Generate | None]
    target: NotRequired[TargetChoice]
    goal: NotRequired[Goal]
    attack: NotRequired[Apgd | CmaEs | Fgsm | MiFgsm | NaturalGradient | PRgf | Spsa | Square | Zoo]
    tolerance: NotRequired[float | Literal['exact']]
    analysis: NotRequired[AnalysisRequest]
    seed: NotRequired[int]

class JobSummary(TypedDict):
    """A job without its request and result, as lists show it."""
    id: str
    state: State
    created: str
    times: dict[str, str]
    attempt: int
    priority: NotRequired[Priority]
    waiting: NotRequired[str | None]
    kind: NotRequired[JobKind]
    seed: int
    progress: ProgressView | None
    title: NotRequired[str | None]
    tags: NotRequired[list[str]]
    retry_of: NotRequired[str | None]
    name: str
    scene: str
    attack: str
    renderer: str
    method: str
    target: str
    question: str | None
    checked: NotRequired[bool]
    warnings: NotRequired[list[JobWarning]]
    outcome: Outcome | None
    failure: FailureView | None
    errors: NotRequired[list[BadField]]

class JobTable(TypedDict):
    """Every job that meets a query."""
    items: list[JobRow]

class JobView(TypedDict):
    """A job with its request and its result."""
    id: str
    state: State
    created: str
    times: dict[str, str]
    attempt: int
    priority: NotRequired[Priority]
    waiting: NotRequired[str | None]
    kind: NotRequired[JobKind]
    seed: int
    progress: ProgressView | None
    title: NotRequired[str | None]
    tags: NotRequired[list[str]]
    retry_of: NotRequired[str | None]
    name: str
    scene: str
    attack: str
    renderer: str
    method: str
    target: str
    question: str | None
    checked: NotRequired[bool]
    warnings: NotRequired[list[JobWarning]]
    outcome: Outcome | None
    failure: FailureView | None
    errors: NotRequired[list[BadField]]
    spec: JobSpec | RerenderingSpec | dict[str, Any]
    note: NotRequired[str | None]
    result: Result | RerenderingView | None

class JobWarning(TypedDict):
    """A warning about one field of an accepted request."""
    code: Literal['already-wrong', 'truth-unknown', 'low-confidence']
    field: str
    text: str

class Lights(TypedDict):
    """All lights of a scene. The torch renderer uses the environment map, pyrender the others."""
    ambient: NotRequired[float]
    points: NotRequired[list[PointLight]]
    directional: NotRequired[list[DirectionalLight]]
    spots: NotRequired[list[SpotLight]]
    environment: NotRequired[Environment]

class LightsRecord(TypedDict):
    """The positions of the three point lights of a scene made here."""
    key: list[float]
    fill: list[float]
    back: list[float]

class MeanCurves(TypedDict):
    """The mean curves of all cases of a cell. A case that has ended keeps its last value, so all are in every mean."""
    loss: list[float]
    advantage: list[float]
    distance: list[float]
    target: str
    attack: str
    cases: int

class MiFgsm(TypedDict):
    """Momentum iterative FGSM (Dong et al. 2018): gradients divided by their ℓ1 norm are accumulated, and each step
    is along the sign of the sum.
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['mi-fgsm']]
    steps: NotRequired[int]
    learning_rate: NotRequired[dict[str, float]]
    decay: NotRequired[float]
    loss: NotRequired[Literal['log-odds', 'margin', 'dlr']]

class MinimalChange(TypedDict):
    """The smallest scale of the stored perturbation that was found to fool the network.

    Success need not be monotone along the ray: `smallest.scale` is below `fools_from` where a scanned scale
    between them holds, and what lies between two scanned scales is not known.
    """
    smallest: RayPoint | None
    holds_at: float
    fools_from: float | None
    scan: list[RayPoint]
    images: int
    change: list[PhysicalChange]
    stored_change: list[PhysicalChange]

class MinimalRequest(TypedDict):
    """The smallest scale of the stored perturbation that still fools the network."""
    scans: NotRequired[int]
    bisections: NotRequired[int]

class NaturalGradient(TypedDict):
    """Natural gradient (Amari 1998) in the metric of perceptibility, with a trust region: of all steps whose image
    changes by the same p, the one that lowers the objective most to first order. It uses the differences of
    images from which the gradient is taken anyway, so it is for renderers without gradients.
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['natural-gradient']]
    steps: NotRequired[int]
    radius: NotRequired[float]

ObjectRecord = TypedDict("ObjectRecord", {"shape": Literal['cube', 'sphere', 'cylinder'], "size": Literal['small', 'large'], "material": Literal['rubber', 'metal'], "color": Literal['gray', 'red', 'blue', 'green', 'brown', 'purple', 'cyan', 'yellow'], "3d_coords": list[float], "rotation": float, "pixel_coords": list[int | float]})

class Outcome(TypedDict):
    """The verdict, the network's answers and the cost of a finished job."""
    outcome: Literal['fooled', 'changed', 'became-right', 'still-wrong', 'held']
    right_before: NotRequired[bool | None]
    fooled: bool
    verified: bool
    stopped: str
    before: str
    before_confidence: float
    after: str
    after_confidence: float
    answers: NotRequired[list[list[str]]]
    float_perceptibility: NotRequired[float | None]
    perceptibility: float
    perceptibility_limit: NotRequired[float | None]
    epsilon_bound: NotRequired[bool]
    steps: int
    queries: int
    seconds: float

class PRgf(TypedDict):
    """Prior-guided random gradient-free search (Cheng et al. 2019, in the form of Cheng, Wu and Zhu 2021): the
    gradient is projected onto the span of random directions and of a surrogate's gradient, and moved by Adam. It
    needs scores only; the gradient is that of another target.
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['p-rgf']]
    steps: NotRequired[int]
    delta: NotRequired[dict[str, float]]
    learning_rate: NotRequired[dict[str, float]]
    surrogate: NotRequired[str | None]
    pairs: NotRequired[int]

class PhysicalChange(TypedDict):
    """The size of the change of one thing in the scene."""
    group: str
    subject: str
    measure: str
    value: float
    unit: str

class Plan(TypedDict):
    """A renderer's plan: what is kept and what is left out, the steps, their methods, estimated costs and errors."""
    renderer: str
    groups: list[str]
    size: list[int]
    tolerance: float | Literal['exact']
    items: list[Item]
    stages: list[Stage]
    error: float
    error_is: NotRequired[Literal['maximum', 'mean']]
    gradients: NotRequired[list[GradientError]]
    environment_map_error: NotRequired[float | None]

class PointLight(TypedDict):
    """A point light of the pyrender renderer; its light falls off with the square of the distance."""
    energy: NotRequired[float]
    position: NotRequired[list[float]]

class PreviewView(TypedDict):
    """The preview of a request."""
    spec: JobSpec
    answers: list[FirstAnswer]
    warnings: list[JobWarning]
    png: str
    plan: JobPlan | None
    cost: Cost | None

Priority = Literal['high', 'normal', 'low']

class ProblemDetails(TypedDict):
    """An error (RFC 9457)."""
    type: NotRequired[str]
    title: str
    status: int
    detail: str
    errors: NotRequired[list[BadField]]

class ProgressView(TypedDict):
    """The progress of a job."""
    phase: str
    step: int
    steps: int

class Provenance(TypedDict):
    """The inputs and versions that reproduce the result bit for bit."""
    seed: int
    backend: str
    versions: dict[str, str]
    scene_sha256: str
    weights_sha256: str
    surrogate_sha256: NotRequired[str | None]
    meshes: dict[str, str]
    credits: list[str]
    card_sha256: NotRequired[str | None]
    extensions: NotRequired[dict[str, str]]

class QuestionGrid(TypedDict):
    """Scenes after CLEVR, and questions about them. Each question is a case of its own, or those of a scene
    together.

    They follow from this request alone, on every machine.
    """
    images: int
    seed: NotRequired[int]
    first: NotRequired[int]
    objects: NotRequired[list[int]]
    questions: NotRequired[int]
    question_seed: NotRequired[int]
    kinds: NotRequired[list[str]]
    together: NotRequired[bool]
    size: NotRequired[list[int]]
    shadows: NotRequired[bool]

class QuestionResult(TypedDict):
    """A question and its answers to the original and the attacked image."""
    question: str | None
    program: list[dict[str, Any]]
    kind: str
    right: str
    right_after: str | None
    before: Answer
    after: Answer
    before_of_kind: bool
    after_of_kind: bool
    outcome: Literal['fooled', 'changed', 'became-right', 'still-wrong', 'held']
    attention: list[Attended]

class RandomViews(TypedDict):
    """Azimuths drawn uniformly from [0, π), as the paper's, for each mesh its own."""
    random: int
    seed: NotRequired[int]

class Rate(TypedDict):
    """A share of cases, with Wilson's 95 % interval; null where there is no case."""
    count: int
    of: int
    rate: float | None
    low: float | None
    high: float | None

class RayPoint(TypedDict):
    """The network's answer to the stored perturbation times a scale, rendered exactly."""
    scale: float
    label: str
    confidence: float
    goal_probability: float
    float_perceptibility: float
    perceptibility: float
    fooled: bool

class Readiness(TypedDict):
    """Whether the service can take jobs and run them."""
    ready: bool
    database: bool
    redis: bool
    storage: bool
    worker: bool
    workers: int
    extensions: list[ExtensionView] | None
    targets: list[TargetFolderView] | None

class Rerendering(TypedDict):
    """The re-rendering defence applied to one image."""
    optimiser: str
    rate: float
    losses: list[float]
    before: Said
    after: Said
    distance: float

class RerenderingBody(TypedDict):
    """An image of a known scene, and the network to defend."""
    image: ImageOfScene
    scene: NotRequired[Scene | None]
    target: NotRequired[TargetChoice | None]
    fit: NotRequired[RerenderingRequest]

class RerenderingRequest(TypedDict):
    """The re-rendering defence: one fit of normals, illumination and material, and the answer to its rendering."""
    optimiser: NotRequired[Literal['sgd', 'adam']]
    rate: NotRequired[float]
    steps: NotRequired[int]

class RerenderingSpec(TypedDict):
    """The request of a job that fits a scene to an image, and asks a network about the fitted scene's rendering."""
    image: str
    scene: Scene
    target: TargetChoice
    fit: RerenderingRequest

class RerenderingView(TypedDict):
    """The network's answers to the image and to the rendering of the scene fitted to it."""
    rerendering: Rerendering
    png: str

class Result(TypedDict):
    """The outcome of a job that ran to its end.

    fooled: the network's answer to the loop's image, truncated and rounded to 8 bits, met the goal. verified:
    its answer to the stored perturbation, rendered afresh by the exact path and rounded to 8 bits, meets the
    goal too. Only a verified perturbation is called an adversary, and only the outcome "fooled" counts as a
    success.
    """
    spec: dict[str, Any]
    outcome: Literal['fooled', 'changed', 'became-right', 'still-wrong', 'held']
    truth: NotRequired[list[str]]
    right_before: NotRequired[bool | None]
    fooled: bool
    verified: bool
    stopped: str
    leave: str | None
    labels_to_leave: NotRequired[list[str]]
    reach: str | None
    warnings: NotRequired[list[JobWarning]]
    original: Answer
    attacked: Answer
    in_loop: Answer
    float_perceptibility: NotRequired[float | None]
    perceptibility: float
    group_perceptibility: dict[str, float]
    at_epsilon: NotRequired[dict[str, AtEpsilon]]
    beyond_truncation: int | None
    plan: Plan
    image_error: float
    sampled_error: NotRequired[ImageError | None]
    environment_map_error: NotRequired[float | None]
    subsets: list[Subset]
    attribution: NotRequired[Attribution | None]
    expectation: NotRequired[HeldOver | None]
    changes: NotRequired[list[Change]]
    analyses: NotRequired[Analyses]
    questions: NotRequired[list[QuestionResult]]
    settings: dict[str, Any]
    steps: int
    queries: int
    surrogate_queries: NotRequired[int]
    renders: int
    truncated: int
    seconds: float
    step: int
    trace: list[TraceRow]
    provenance: Provenance

class Said(TypedDict):
    """A network's answer to an image of 8 bits, in short."""
    label: str
    confidence: float

class Scene(TypedDict):
    """A complete scene. Only `objects` has no default."""
    camera: NotRequired[Camera]
    objects: list[SceneObject]
    floor: NotRequired[Floor | None]
    lights: NotRequired[Lights]
    shadows: NotRequired[Shadows | None]
    ground: NotRequired[list[float]]
    background: NotRequired[Background | None]

class SceneGrid(TypedDict):
    """One object per scene: meshes × azimuths. All scenes have the same camera, lights, ground and material."""
    meshes: NotRequired[list[str]]
    kinds: NotRequired[list[str]]
    per_kind: NotRequired[int | None]
    views: NotRequired[RandomViews | list[float]]
    material: NotRequired[str]
    camera: NotRequired[Camera]
    lights: NotRequired[Lights]
    ground: NotRequired[list[float]]

class SceneLibrary(TypedDict):
    """The meshes and environment maps that a scene can name."""
    meshes: list[Entry]
    environments: list[Entry]
    credits: list[str]

class SceneObject(TypedDict):
    """A mesh in the scene, with its surface and its pose."""
    mesh: str
    material: NotRequired[str]
    color: NotRequired[list[float]]
    translation: NotRequired[list[float]]
    rotation: NotRequired[list[float]]
    scale: NotRequired[float]
    metallic: NotRequired[float | None]
    roughness: NotRequired[float | None]

class SceneRecord(TypedDict):
    """A scene. `relationships[r][i]` are the indices of the objects that have relation r to object i."""
    split: str
    image_index: int
    image_filename: str
    objects: list[ObjectRecord]
    relationships: dict[str, list[list[int]]]
    directions: dict[str, list[float]]
    camera: NotRequired[CameraRecord | None]
    lights: NotRequired[LightsRecord | None]

class Selection(TypedDict):
    """The views that are attacked: those whose first answer is right, and of these the preferred ones."""
    right: NotRequired[bool]
    least_confidence: NotRequired[float]
    per_mesh: NotRequired[int | None]
    per_class: NotRequired[int | None]
    most: NotRequired[int | None]
    shared: NotRequired[bool]
    prefer: NotRequired[Literal['confident', 'listed']]

class Shadows(TypedDict):
    """Shadows that objects cast on each other and on themselves."""
    softness: NotRequired[float]
    angle: NotRequired[float]
    resolution: NotRequired[int]
    samples: NotRequired[int]
    texel_samples: NotRequired[int]

class Shares(TypedDict):
    """How the effect of the whole perturbation on one quantity is shared out among its parts."""
    effect: float
    shapley: list[float]
    standard_error: NotRequired[list[float] | None]
    interactions: NotRequired[list[list[float]] | None]

class SpotLight(TypedDict):
    """A point light of the pyrender renderer that shines into a cone only."""
    energy: NotRequired[float]
    position: NotRequired[list[float]]
    direction: NotRequired[list[float]]
    inner_angle: NotRequired[float]
    outer_angle: NotRequired[float]

class Spsa(TypedDict):
    """Simultaneous perturbation (Spall 1992): all parameters move at once along random directions and back, and the
    mean of the differences, moved by Adam, estimates the gradient (Uesato et al. 2018). It needs scores only.
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['spsa']]
    steps: NotRequired[int]
    delta: NotRequired[dict[str, float]]
    learning_rate: NotRequired[dict[str, float]]
    pairs: NotRequired[int]
    directions: NotRequired[Literal['signs', 'gaussian']]

class Square(TypedDict):
    """Square Attack (Andriushchenko et al. 2020): a square at a random place is set to ±ε in each channel, and kept
    if the objective falls. It needs scores only, one query a step. Where it succeeds and gradient methods hold,
    the network's gradient misleads them.
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['square']]
    steps: NotRequired[int]
    share: NotRequired[float]
    loss: NotRequired[Literal['log-odds', 'margin', 'dlr']]

class Stage(TypedDict):
    """A step of making an image."""
    part: NotRequired[str]
    name: str
    method: str
    when: Literal['once', 'every image']
    evaluations: int
    unit: str
    why: str
    error: NotRequired[float]
    share: NotRequired[float]

State = Literal['queued', 'running', 'cancelling', 'succeeded', 'failed', 'rejected', 'cancelled']

class Subset(TypedDict):
    """The network's answer to the stored perturbation with only some of its groups applied, rendered exactly."""
    groups: list[str]
    label: str
    confidence: float
    goal_probability: float
    goal_log_odds: NotRequired[float | None]
    float_perceptibility: NotRequired[float | None]
    perceptibility: float
    fooled: bool

class Table(TypedDict):
    """The table of a campaign: a row for each target, a column for each attack."""
    campaign: str
    targets: list[str]
    attacks: list[str]
    cells: list[Cell]

class TargetChoice(TypedDict):
    """The network under attack and, if it answers questions about images, the question."""
    name: NotRequired[str]
    question: NotRequired[str | list[Call] | None]
    questions: NotRequired[list[str | list[Call]]]

class TargetFolderView(TypedDict):
    """A folder of SCENE_ATTACK_TARGETS, as the service found it."""
    name: str
    card_sha256: str | None
    error: str | None

class TargetInfo(TypedDict):
    """A target's model card: its name, task, input size, source and licence. `input_size` is height and width.

    `vocabulary` says what its labels are, from which the truth of a scene follows (services.targets.truth):
    those of ImageNet-1k, the kinds of the library's furniture, the answers to questions about CLEVR's scenes, or
    something else.
    """
    name: str
    title: str
    task: Literal['classification', 'question answering']
    input_size: list[int]
    classes: int
    differentiable: bool | None
    takes_question: bool
    source: str
    licence: str
    vocabulary: NotRequired[Literal['imagenet', 'furniture-14', 'clevr', 'custom']]
    example: NotRequired[str | None]
    missing: NotRequired[str | None]
    card_sha256: NotRequired[str | None]

class TargetList(TypedDict):
    """The networks that can be attacked."""
    items: list[TargetInfo]

class TraceRow(TypedDict):
    """The state at the start of a step, before its update; scores are those of the image rounded to 8 bits."""
    step: int
    restart: NotRequired[int]
    loss: float
    label: str
    confidence: float
    advantage: float
    objective: NotRequired[float | None]
    share: NotRequired[float | None]
    distance: float
    perceptibility: float
    truncated: int
    below_noise: NotRequired[int]
    queries: int
    surrogate_queries: NotRequired[int]
    renders: int
    seconds: float

class TransferRequest(TypedDict):
    """The stored perturbation before other networks, and in the other renderer."""
    targets: NotRequired[list[str]]
    renderers: NotRequired[list[str]]

class Transferred(TypedDict):
    """What a network, asked in transfer, says of the original and of the attacked image."""
    target: str
    renderer: str
    before: Said
    after: Said
    outcome: Literal['fooled', 'changed', 'became-right', 'still-wrong', 'held']
    right_before: bool | None
    note: NotRequired[str]

class Uploaded(TypedDict):
    """An uploaded mesh or environment map."""
    name: str
    title: str
    kind: Literal['furniture', 'primitive', 'upload', 'environment']
    category: str
    creator: str
    licence: str
    credit: str | None
    size: NotRequired[list[float] | None]
    triangles: NotRequired[int | None]
    used: NotRequired[list[str]]
    notes: NotRequired[list[str]]
    thumbnail: str

class ViewList(TypedDict):
    """All views of a campaign, with the networks' first answers; empty until they are known."""
    items: list[ChosenView]

class Zoo(TypedDict):
    """Zeroth-order optimisation: Adam on central differences at random coordinates, of loss + weight·‖ΔY‖² (paper,
    section 3.2).
    """
    truncation: NotRequired[int | None]
    constraint: NotRequired[Literal['truncate', 'backtrack', 'epsilon']]
    perceptibility: NotRequired[float | None]
    epsilon: NotRequired[dict[str, float]]
    bounds: NotRequired[dict[str, list[float]]]
    restarts: NotRequired[int]
    renderer: NotRequired[Literal['image', 'pyrender', 'torch']]
    groups: NotRequired[list[str]]
    base_renderer: NotRequired[Literal['pyrender', 'torch'] | None]
    queries: NotRequired[int | None]
    seconds: NotRequired[float | None]
    expectation: NotRequired[Expectation | None]
    leave_out: NotRequired[dict[str, float]]
    method: NotRequired[Literal['zoo']]
    steps: NotRequired[int]
    preset: NotRequired[Literal['paper-classification', 'paper-vqa', 'measured']]
    coordinates: NotRequired[int]
    delta: NotRequired[float | Literal['measured'] | dict[str, float]]
    learning_rate: NotRequired[float | dict[str, float]]
    weight: NotRequired[float]
