"""``skinplan bag``: what is in a bag, and healing one whose recording was cut off."""

from pathlib import Path
from typing import Annotated, Any

import typer

from skinplan import console
from skinplan.recording.heal import heal_bag, is_finished
from skinplan.recording.model import BagInfo, BagTopic
from skinplan.recording.reader import open_bag

bag_app = typer.Typer(no_args_is_help=True, help="Look into bags, heal and export them.")

BagArgument = Annotated[Path, typer.Argument(help="Folder of a bag, or an MCAP file.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]


@bag_app.command()
def info(bag: BagArgument, as_json: JsonOption = False) -> None:
    """Say what is in a bag."""
    with console.command(as_json):
        found = open_bag(bag)
        if as_json:
            console.print_json(_document(found))
            return
        rows = [
            (topic.name, topic.type_name, topic.messages, _qos(topic)) for topic in found.topics
        ]
        header = ("topic", "type", "messages", "offered QoS")
        console.print_table(f"{bag}: {found.duration_s:.3f} s", header, rows)
        facts = [
            ("files", len(found.files)),
            ("bytes", found.bytes),
            ("messages", found.messages),
            ("closed in order", "yes" if is_finished(bag) else "no: skinplan bag heal closes it"),
            *sorted(found.custom_data.items()),
        ]
        console.print_table("Recording", ("what", "value"), facts)


@bag_app.command()
def heal(
    bag: BagArgument,
    thorough: Annotated[
        bool,
        typer.Option("--thorough", help="Read files that were closed in order, too."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Close a bag whose recording was cut off, and say what was lost."""
    with console.command(as_json):
        report = heal_bag(bag, thorough)
        if as_json:
            files = [
                {
                    "file": str(file.path),
                    "healed": file.healed,
                    "messages": file.messages,
                    "end_ns": file.end_ns,
                    "bytes_before": file.bytes_before,
                    "bytes_lost": file.bytes_lost,
                    "messages_undescribed": file.messages_undescribed,
                    "damaged": [list(place) for place in file.damaged],
                    "kept": None if file.kept is None else str(file.kept),
                }
                for file in report.files
            ]
            console.print_json(
                {"bag": str(bag), "metadata_rebuilt": report.metadata_rebuilt, "files": files}
            )
            return
        for file in report.files:
            typer.echo(file.sentence())
        if report.metadata_rebuilt:
            typer.echo("metadata.yaml was written anew")


def _document(found: BagInfo) -> dict[str, Any]:
    return {
        "bag": str(found.path),
        "files": [str(file) for file in found.files],
        "duration_s": found.duration_s,
        "messages": found.messages,
        "bytes": found.bytes,
        "finished": is_finished(found.path),
        "custom_data": found.custom_data,
        "topics": [
            {
                "topic": topic.name,
                "type": topic.type_name,
                "type_hash": topic.type_hash,
                "messages": topic.messages,
                "qos": _qos(topic),
            }
            for topic in found.topics
        ],
    }


def _qos(topic: BagTopic) -> str:
    kinds = {f"{profile.reliability}, {profile.durability}" for profile in topic.qos}
    return "; ".join(sorted(kinds))
