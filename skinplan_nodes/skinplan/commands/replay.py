"""``skinplan replay``: says what is in a bag and plays it into the graph of this machine."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from skinplan import console
from skinplan.errors import InputError
from skinplan.recording.model import BagInfo
from skinplan.recording.qos_overrides import read_overrides
from skinplan.recording.reader import open_bag
from skinplan.recording.topic_filter import TopicFilter
from skinplan.replay_run import ParameterValue, replay_bag
from skinplan.verify_run import verify_run

# Differences of a stage that are shown in the table; --json has all.
_MOST_SHOWN = 5


def replay(
    bag: Annotated[Path, typer.Argument(help="Folder of a bag, or a storage file.")],
    rate: Annotated[
        float, typer.Option(min=0.01, max=100.0, help="Times faster than recorded.")
    ] = 1.0,
    start_s: Annotated[
        float, typer.Option("--start", min=0.0, help="Begin at this offset [s].")
    ] = 0.0,
    duration_s: Annotated[
        float, typer.Option("--duration", min=0.0, help="Play so much [s]; 0 = all.")
    ] = 0.0,
    until_s: Annotated[
        float, typer.Option("--until", min=0.0, help="End at this offset [s]; 0 = at the end.")
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Start again at the end.")] = False,
    paused: Annotated[
        bool, typer.Option("--paused", help="Wait for the service player/resume.")
    ] = False,
    delay_s: Annotated[
        float, typer.Option("--delay", min=0.0, max=60.0, help="Wait before the first message [s].")
    ] = 1.0,
    topic: Annotated[
        list[str] | None, typer.Option("--topic", help="Play this topic; may be repeated.")
    ] = None,
    regex: Annotated[str, typer.Option(help="Play topics of this pattern.")] = "",
    exclude: Annotated[
        list[str] | None, typer.Option("--exclude", help="Leave out this topic; repeatable.")
    ] = None,
    exclude_regex: Annotated[str, typer.Option(help="Leave out topics of this pattern.")] = "",
    remap: Annotated[
        list[str] | None, typer.Option("--remap", help="Another name, old:=new; repeatable.")
    ] = None,
    qos_overrides: Annotated[
        Path | None, typer.Option(help="YAML file of QoS by topic, as rosbag2 has it.")
    ] = None,
    clock_hz: Annotated[
        float, typer.Option("--clock", min=0.0, max=1000.0, help="Rate of /clock [Hz]; 0 = none.")
    ] = 50.0,
    clock_topic: Annotated[
        list[str] | None,
        typer.Option("--clock-topic", help="/clock before every message of it; repeatable."),
    ] = None,
    clock_per_message: Annotated[
        bool, typer.Option("--clock-per-message", help="/clock before every message.")
    ] = False,
    ack_timeout_s: Annotated[
        float,
        typer.Option(
            "--wait-acked", min=-1.0, help="Wait at the end for subscribers [s]; -1 = on."
        ),
    ] = 2.0,
    verify: Annotated[
        bool,
        typer.Option("--verify", help="Feed a run's inputs to the nodes again; compare results."),
    ] = False,
    part: Annotated[
        Path | None, typer.Option(help="With --verify: part file in the place of the recorded one.")
    ] = None,
    cell: Annotated[
        Path | None, typer.Option(help="With --verify: cell file; without it the default cell.")
    ] = None,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="With --verify: node.parameter=value; repeatable."),
    ] = None,
    info: Annotated[bool, typer.Option("--info", help="Only say what is in the bag.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on stdout.")
    ] = False,
) -> None:
    """Play a bag into the graph of this machine, with its clock."""
    with console.command(as_json):
        found = open_bag(bag)
        if verify:
            _show_verified(verify_run(bag, part, cell, change or ()), as_json)
            return
        if part or cell or change:
            raise InputError("--part, --cell and --set were given; they are accepted with --verify")
        chosen = TopicFilter(tuple(topic or ()), regex, tuple(exclude or ()), exclude_regex)
        chosen.require_known(known.name for known in found.topics)
        if qos_overrides is not None:
            read_overrides(qos_overrides)
        _require_within(found, start_s)
        document = _described(bag, found)
        if not as_json:
            rows = [(t["topic"], t["type"], t["messages"]) for t in document["topics"]]
            console.print_table(
                f"{bag}: {found.duration_s:.1f} s", ("topic", "type", "messages"), rows
            )
        if not info:
            parameters: dict[str, ParameterValue] = {
                "rate": float(rate),
                "start_offset_s": float(start_s),
                "duration_s": float(duration_s),
                "until_s": float(until_s),
                "loop": loop,
                "start_paused": paused,
                "start_delay_s": float(delay_s),
                "topics": _texts(topic),
                "regex": regex,
                "exclude_topics": _texts(exclude),
                "exclude_regex": exclude_regex,
                "qos_overrides": str(qos_overrides.absolute()) if qos_overrides else "",
                "clock_rate_hz": float(clock_hz),
                "clock_topics": _texts(clock_topic),
                "clock_per_message": clock_per_message,
                "ack_timeout_s": float(ack_timeout_s),
                "exit_at_end": True,
            }
            document["played"] = replay_bag(bag, parameters, remap or ())
        if as_json:
            console.print_json(document)


def _show_verified(document: dict[str, Any], as_json: bool) -> None:
    """Prints how each stage compares; ends with code 1 when one differs."""
    if as_json:
        console.print_json(document)
    else:
        rows = [
            (
                stage["name"],
                stage["compared"],
                len(stage["differences"]) or "identical" if stage["compared"] else "-",
                "\n".join([*stage["differences"][:_MOST_SHOWN], *stage["notes"]]),
            )
            for stage in document["stages"]
        ]
        header = ("stage", "compared", "differences", "first of them, notes")
        console.print_table(f"Verification of {document['bag']}", header, rows)
    if not document["identical"]:
        first = document["first_difference"]
        console.stderr.print(f"[bold red]skinplan:[/] the first stage that differs: {first}")
        raise typer.Exit(console.EXIT_FAILED)
    if not as_json:
        typer.echo("identical")


def _texts(given: Iterable[str] | None) -> list[str]:
    # ROS can't tell the type of an empty list.
    return list(given or ()) or [""]


def _require_within(found: BagInfo, offset_s: float) -> None:
    if offset_s > found.duration_s:
        raise InputError(
            f"replay was asked to start at {offset_s:g} s, the bag is {found.duration_s:.1f} s "
            "long; an offset within it is accepted"
        )


def _described(bag: Path, found: BagInfo) -> dict[str, Any]:
    return {
        "bag": str(bag),
        "duration_s": found.duration_s,
        "messages": found.messages,
        "topics": [
            {"topic": topic.name, "type": topic.type_name, "messages": topic.messages}
            for topic in found.topics
        ],
    }
