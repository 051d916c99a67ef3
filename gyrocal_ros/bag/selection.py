"""Selects the topic of a recording for each role, and suggests remedies for missing topics."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from gyrocal_ros.bag.storage import Topic
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.msgs.headings import HEADING_TYPES, HeadingName, parse_heading_name
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import POSES, STATIC_TRANSFORMS, TRANSFORMS, TYPES, Role

NAME_ENDINGS = {role: (str(role),) for role in Role} | {Role.IMAGE: (Role.IMAGE, f'{Role.IMAGE}/compressed')}
"""Endings of the topic names that each role has by default, in order of preference."""
CAMERA_ROLES = (Role.FEATURES, Role.IMAGE)
NEEDED_ROLES = (Role.IMU, Role.WHEELS, Role.FEATURES, Role.IMAGE, Role.CAMERA_INFO, Role.HEADING)
"""Roles that calibration relies on; the topics of the others are optional and may be faulty."""

WHEEL_WORDS = ('odom', 'wheel', 'encoder', 'base_controller', 'velocity_controller')
SIGHT_WORDS = ('visual', 'stereo', 'lidar', 'laser', 'scan', 'vio', 'slam', 'camera', 'mocap', 'vicon')
"""Parts of the names of topics of wheel odometry, and of others that are called odometry, too."""
FUSED_WORDS = ('filtered', 'fused', 'ekf', 'ukf')
"""Parts of the names of topics that a filter publishes which probably uses the gyro itself."""
OBVIOUS_TYPES = (*POSES, 'geometry_msgs/msg/TransformStamped')
"""Types of a heading reference that is suggested, or used without being named if it is the only one. The
orientation of an IMU comes mostly from its gyro, and a compass is disturbed indoors: they must be named."""

NOT_COVARIATES = (
    'geometry_msgs/',
    'nav_msgs/',
    'tf2_msgs/',
    'visualization_msgs/',
    'rcl_interfaces/',
    'rosgraph_msgs/',
    *(f'sensor_msgs/msg/{name}' for name in ('Imu', 'NavSat', 'Image', 'Compressed', 'Camera', 'Point')),
)
"""Prefixes of types that describe motion or setup of the robot: no physical cause of gyro errors."""


@dataclass(frozen=True, slots=True)
class TopicOptions:
    """Options of the user for the selection of topics."""

    remap: Mapping[Role, str] = field(default_factory=dict)
    """Names of topics that differ from the usual ones."""
    namespace: str | None = None
    """Namespace of the robot, if the recording holds several."""
    heading_reference: str | None = None
    """Name of the heading reference, in place of the ceiling camera; see `msgs.headings`."""
    use_images: bool = False
    """True to use the images even if there are features."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Topics of a recording that are in use."""

    topics: Mapping[Role, Topic]
    static_transforms: tuple[Topic, ...]
    others: Mapping[str, Topic]
    """Topics that may hold covariates, by their name without namespace."""
    issues: tuple[BagIssue, ...]
    """Missing, ambiguous or unusable topics."""
    heading: HeadingName | None = None
    """What the topic of the heading reference provides; None without one."""


def parse_remap(words: Iterable[str]) -> dict[str, str]:
    """Parse remaps in the notation of ROS.

    Args:
        words: remaps, each `NAME:=TOPIC`.

    Raises:
        ConfigError: a remap has another form.
    """
    remap = {}
    for word in words:
        name, _, topic = word.partition(':=')
        if not (name and topic):
            raise ConfigError(f'{word!r} is not a remap', todo='write NAME:=TOPIC, as in imu/data_raw:=/imu')
        remap[name.strip('/')] = topic
    return remap


def remap_roles(remap: Mapping[str, str]) -> dict[Role, str]:
    """Look up the roles of remapped names.

    Args:
        remap: usual name of a topic (`imu/data_raw`) to its name in this recording.

    Raises:
        ConfigError: a name is not the usual name of a topic.
    """
    roles = {str(role): role for role in Role if role is not Role.HEADING}
    for name in remap.keys() - roles.keys():
        close = difflib.get_close_matches(name, roles, n=1) or list(roles)
        raise ConfigError(f'cannot remap {name!r}', todo=f'known are {", ".join(close)}')
    return {roles[name]: topic for name, topic in remap.items()}


def select_topics(topics: Mapping[str, Topic], options: TopicOptions) -> Selection:
    """Select the topic of each role.

    A topic is identified by the end of its name: `/robot1/imu/data_raw` is `imu/data_raw` of `robot1`.

    Args:
        topics: all topics of the recording by name.
        options: options of the user.
    """
    issues: list[BagIssue] = []
    robots = _robot_namespaces(topics)
    robot = _select_robot(topics, robots, options, issues)
    selected: dict[Role, Topic] = {}
    for role in (role for role in Role if role is not Role.HEADING):
        if role in options.remap:
            topic = _find_by_name(topics, options.remap[role], issues)
        else:
            any_namespace = len(robots) < 2 and options.namespace is None
            topic = _find_by_ending(topics, role, robot, any_namespace=any_namespace)
        if topic and _is_usable(topic, role, TYPES[role], issues):
            selected[role] = topic
    if not options.heading_reference:
        options = _with_obvious_reference(topics, selected, options, issues)
    heading = _select_heading(topics, selected, options, issues)
    _keep_one_reference(selected, options)
    issues += _missing_topics(topics, selected, options)
    return Selection(
        selected,
        tuple(t for t in topics.values() if t.type_name == TRANSFORMS and t.name.endswith(STATIC_TRANSFORMS)),
        dict(_other_topics(topics, selected, robot, robots)),
        tuple(issues),
        heading,
    )


def _select_heading(
    topics: Mapping[str, Topic], selected: dict[Role, Topic], options: TopicOptions, issues: list[BagIssue]
) -> HeadingName | None:
    """Select the topic of the heading reference; return what it provides, None without a usable one."""
    if not options.heading_reference:
        return None
    name = parse_heading_name(options.heading_reference)
    topic = _find_by_name(topics, name.topic, issues)
    fitting = (TRANSFORMS,) if name.frames else HEADING_TYPES
    if topic is None or not _is_usable(topic, Role.HEADING, () if name.field else fitting, issues):
        return None
    selected[Role.HEADING] = topic
    return name


def _with_obvious_reference(
    topics: Mapping[str, Topic],
    selected: Mapping[Role, Topic],
    options: TopicOptions,
    issues: list[BagIssue],
) -> TopicOptions:
    """Return the options with the one obvious heading reference, if there is no camera and only one."""
    if any(role in selected for role in CAMERA_ROLES):
        return options
    obvious = [
        topic.name
        for topic in _possible_references(topics, selected)
        if not _is_named_like_wheels(topic) and not any(word in topic.name.lower() for word in FUSED_WORDS)
    ]
    if len(obvious) != 1:
        return options
    text = f'there is no ceiling camera; {obvious[0]} is used as the heading reference'
    todo = 'name another one with --heading-reference'
    issues.append(BagIssue(Severity.NOTE, 'chosen_reference', obvious[0], text, todo))
    return replace(options, heading_reference=obvious[0])


def _possible_references(topics: Mapping[str, Topic], selected: Mapping[Role, Topic]) -> list[Topic]:
    """Return the unused topics that may be heading references."""
    return [
        topic
        for topic in topics.values()
        if topic.count and topic.type_name in OBVIOUS_TYPES and topic not in selected.values()
    ]


def _is_named_like_wheels(topic: Topic) -> bool:
    name = topic.name.lower()
    return any(word in name for word in WHEEL_WORDS) and not any(word in name for word in SIGHT_WORDS)


def _namespace(name: str, ending: str) -> str | None:
    """Return the part of a topic's name before an ending, None if the name has another ending."""
    before, separator, rest = f'/{name.strip("/")}'.rpartition(f'/{ending}')
    return before.strip('/') if separator and not rest else None


def _matches(topics: Mapping[str, Topic], role: Role) -> Iterator[tuple[str, Topic]]:
    """Yield namespace and topic for the topics with the usual name of a role."""
    for ending in NAME_ENDINGS[role]:
        for topic in topics.values():
            namespace = _namespace(topic.name, ending)
            if namespace is not None:
                yield namespace, topic


def _robot_namespaces(topics: Mapping[str, Topic]) -> list[str]:
    """Return the namespaces with an IMU; if some have a ceiling camera too, only those."""
    with_imu = [namespace for namespace, _ in _matches(topics, Role.IMU)]
    with_camera = {namespace for role in CAMERA_ROLES for namespace, _ in _matches(topics, role)}
    return [namespace for namespace in with_imu if namespace in with_camera] or with_imu


def _select_robot(
    topics: Mapping[str, Topic], robots: list[str], options: TopicOptions, issues: list[BagIssue]
) -> str:
    """Return the namespace of the robot, an empty string if there is none."""
    if options.namespace is not None:
        robot = options.namespace.strip('/')
        namespaces = {namespace for role in Role for namespace, _ in _matches(topics, role)}
        if robot not in namespaces:
            known = ', '.join(sorted(f'/{namespace}' for namespace in namespaces)) or 'none'
            issues.append(
                BagIssue(
                    Severity.ERROR,
                    'no_such_robot',
                    '',
                    f'no robot has the namespace /{robot}',
                    f'known: {known}',
                )
            )
        return robot
    if len(robots) > 1 and Role.IMU not in options.remap:
        names = ', '.join(f'/{robot}' for robot in robots)
        issues.append(
            BagIssue(
                Severity.ERROR,
                'several_robots',
                '',
                f'there are several robots: {names}',
                'choose with --namespace',
            )
        )
    return robots[0] if robots else ''


def _find_by_ending(
    topics: Mapping[str, Topic], role: Role, robot: str, *, any_namespace: bool
) -> Topic | None:
    """Return the topic of the robot with the usual name of a role, if possible one with messages.

    If the robot has none and `any_namespace` is set, a topic of the only other namespace is returned.
    """
    matches = list(_matches(topics, role))
    own = [topic for namespace, topic in matches if namespace == robot]
    if not own and any_namespace and len({namespace for namespace, _ in matches}) == 1:
        own = [topic for _, topic in matches]
    return next((topic for topic in own if topic.count), own[0] if own else None)


def _find_by_name(topics: Mapping[str, Topic], name: str, issues: list[BagIssue]) -> Topic | None:
    matching = [topic for topic in topics.values() if topic.name.strip('/') == name.strip('/')]
    matching += [topic for topic in topics.values() if _namespace(topic.name, name.strip('/')) is not None]
    if matching:
        return matching[0]
    close = difflib.get_close_matches(name, list(topics), n=1, cutoff=0.5)
    todo = f'did you mean {close[0]}?' if close else f'the recorded topics are {", ".join(topics)}'
    issues.append(BagIssue(Severity.ERROR, 'missing_topic', name, 'there is no such topic', todo))
    return None


def _is_usable(topic: Topic, role: Role, types: Collection[str], issues: list[BagIssue]) -> bool:
    """Return True if a topic has messages of one of some types (none: any); append an issue otherwise."""
    severity = Severity.ERROR if role in NEEDED_ROLES else Severity.WARNING
    if types and topic.type_name not in types:
        text = f'is a {topic.type_name}, not a {" or ".join(types)}'
        issues.append(BagIssue(severity, 'wrong_type', topic.name, text, f'use another topic as {role}'))
        return False
    if not topic.count:
        issues.append(
            BagIssue(Severity.WARNING, 'empty_topic', topic.name, 'has no messages', 'was its node running?')
        )
        return False
    return True


def _keep_one_reference(selected: dict[Role, Topic], options: TopicOptions) -> None:
    """Remove all heading references but one: the named topic, otherwise the features or the images."""
    unused: tuple[Role, ...] = ()
    if options.heading_reference:
        unused = (*CAMERA_ROLES, Role.CAMERA_INFO)
    elif Role.FEATURES in selected and not (options.use_images and Role.IMAGE in selected):
        unused = (Role.IMAGE,)
    elif Role.IMAGE in selected:
        unused = (Role.FEATURES,)
    for role in unused:
        selected.pop(role, None)


def _missing_topics(
    topics: Mapping[str, Topic], selected: Mapping[Role, Topic], options: TopicOptions
) -> Iterator[BagIssue]:
    """Yield an issue for each needed topic that is missing, and for ground truth used as reference."""

    def missing(role: Role, text: str, todo: str = '', severity: Severity = Severity.ERROR) -> BagIssue:
        todo = todo or _suggest_topic(topics, selected, role)
        return BagIssue(severity, 'missing_topic', str(role), text, todo)

    if Role.IMU not in selected:
        yield missing(Role.IMU, 'there is no IMU')
    if options.heading_reference:
        if Role.WHEELS not in selected:
            yield missing(Role.WHEELS, 'there is no wheel odometry', severity=Severity.NOTE)
        if Role.HEADING in selected and selected[Role.HEADING] == selected.get(Role.TRUTH):
            yield BagIssue(
                Severity.ERROR,
                'truth_as_reference',
                selected[Role.HEADING].name,
                'the ground truth is used for comparison only, never for calibration',
                'name another heading reference',
            )
        return
    if not any(role in selected for role in CAMERA_ROLES):
        poses = [topic.name for topic in _possible_references(topics, selected)]
        option = f'--heading-reference {" or ".join(poses)}' if poses else '--heading-reference TOPIC'
        todo = f'{_suggest_topic(topics, selected, Role.IMAGE)}, or give {option}'
        yield missing(Role.IMAGE, 'there is no ceiling camera', todo)
    elif Role.CAMERA_INFO not in selected:
        yield missing(Role.CAMERA_INFO, 'the camera has no calibration')
    if Role.WHEELS not in selected:
        yield missing(Role.WHEELS, 'there is no wheel odometry')


def _suggest_topic(topics: Mapping[str, Topic], selected: Mapping[Role, Topic], role: Role) -> str:
    """Return advice that names the unused topics that could take a role."""
    free = [topic for topic in topics.values() if topic not in selected.values()]
    fitting = [
        topic.name
        for topic in free
        if topic.type_name in TYPES[role] and (role is not Role.WHEELS or _is_named_like_wheels(topic))
    ]
    if len(fitting) == 1:
        return f'give -r {role}:={fitting[0]}'
    if fitting:
        return f'give -r {role}:=TOPIC with one of {", ".join(fitting)}'
    close = difflib.get_close_matches(str(role), [topic.name.strip('/') for topic in free], n=1)
    return f'did you mean {close[0]}?' if close else f'record {role}'


def _other_topics(
    topics: Mapping[str, Topic], selected: Mapping[Role, Topic], robot: str, robots: list[str]
) -> Iterator[tuple[str, Topic]]:
    """Yield name without namespace and topic of the robot's topics that may hold covariates."""
    other_robots = tuple(f'/{other}/' for other in robots if other not in ('', robot))
    for topic in topics.values():
        name = f'/{topic.name.strip("/")}'
        is_excluded = topic in selected.values() or topic.type_name.startswith(NOT_COVARIATES)
        if topic.count and not is_excluded and not name.startswith(other_robots):
            yield name.removeprefix(f'/{robot}' if robot else '').strip('/'), topic
