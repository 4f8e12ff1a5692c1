"""Puts a plan into a viser scene, with the controls that show and hide its layers.

Frames: the scene's world is ``map``; ``/part`` is the workpiece at its nominal place.
"""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from skinplan.scan_path.model import FEATURE, ROW
from skinplan.transforms import apply, quaternion
from skinplan.view import palette
from skinplan.view.camera import front_axes
from skinplan.view.scene_arm import ArmView, add_tracker
from skinplan.view.scene_data import (
    Piece,
    SceneData,
    arrows,
    field_mesh,
    point_sentence,
    row_lines,
    scanner_pose,
)
from skinplan.view.scene_motion import MotionClock, add_motion


class PlanScene:
    """A plan in a viser server.

    Attributes:
        layers: Name of each layer and the handles of what it shows.
        surfaces: Name of each way to colour the part, and the handles of its pieces.
        checkboxes: The control of each layer.
        switch: The control that chooses a way to colour the part.
        slider: The control that chooses a scan path point; None without a path.
        station_slider: The control that chooses where the arm stands; None without stations.
        arm: The arm; None without stations.
        clock: Moves the arm along its timed motion; None without a motion.
    """

    def __init__(self, server: Any, data: SceneData) -> None:
        """Fills the scene and the control panel.

        Args:
            server: A ``viser.ViserServer``.
            data: What to show.
        """
        self._scene, self._gui, self._data = server.scene, server.gui, data
        self.layers: dict[str, list[Any]] = {}
        self.surfaces: dict[str, list[Any]] = {}
        self.checkboxes: dict[str, Any] = {}
        self.slider: Any = None
        self.station_slider: Any = None
        self.arm: ArmView | None = None
        self.clock: MotionClock | None = None
        self._gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        self._gui.add_markdown(f"**{escape(data.subject.part_id)}**")
        self._add_ground(server)
        self._add_part()
        self._add_path()
        self._add_stations()
        self._add_tracker()
        self._add_colour_switch()
        self._add_point_slider()
        with self._gui.add_folder("Layers"):
            for name, handles in self.layers.items():
                self._add_checkbox(name, handles)

    def _add_ground(self, server: Any) -> None:
        subject = self._data.subject
        self._scene.set_up_direction("+z")
        # viser turns w, x, y, z; ours is x, y, z, w.
        pose = {
            "wxyz": np.roll(quaternion(subject.T_map_workpiece), 1),
            "position": subject.T_map_workpiece[:3, 3],
        }
        self._scene.add_frame("/part", show_axes=False, **pose)
        self._scene.add_frame("/map", axes_length=0.3, axes_radius=0.006, origin_radius=0.01)
        corners = apply(subject.T_map_workpiece, subject.mesh.vertices)
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        floor = self._scene.add_grid(
            "/floor", width=8.0, height=8.0, cell_size=0.5, section_size=1.0,
            position=(float(middle[0]), float(middle[1]), 0.0),
        )  # fmt: skip
        self.layers["floor"] = [floor]
        turn = subject.T_map_workpiece[:3, :3]
        right, toward = (turn @ axis for axis in front_axes(subject.mesh))
        size = float(np.linalg.norm(np.ptp(corners, axis=0)))
        # Behind the stations, which stand about a metre before the part, and a little to the side.
        back = (0.55 * size + 1.3) * toward - 0.35 * size * right
        server.initial_camera.position = middle + back + (0.0, 0.0, 0.3 * size)
        server.initial_camera.look_at = middle + 0.25 * toward

    def _add_part(self) -> None:
        for name, pieces in self._data.colourings.items():
            shown = not self.surfaces
            self.surfaces[name] = [
                self._scene.add_mesh_simple(
                    f"/part/{_node(name)}/{number}",
                    piece.mesh.vertices,
                    piece.mesh.faces,
                    color=_bytes(piece.colour),
                    side="double",
                    visible=shown,
                    cast_shadow=False,
                    receive_shadow=False,
                )
                for number, piece in enumerate(pieces)
            ]

    def _add_path(self) -> None:
        path = self._data.subject.path
        if path is None:
            return
        for kind, name, colour in (
            (ROW, "row points", palette.ROW_POINT),
            (FEATURE, "feature points", palette.FEATURE_POINT),
        ):
            ends = arrows(path, kind)
            if not len(ends):
                continue
            points = self._scene.add_point_cloud(
                f"/part/{_node(name)}", ends[:, 0], _bytes(colour), point_size=0.012,
                point_shape="circle", precision="float32",
            )  # fmt: skip
            directions = self._scene.add_arrows(
                f"/part/view_directions/{_node(name)}", ends, _bytes(colour), shaft_radius=0.0022,
                head_radius=0.006, head_length=0.018,
            )  # fmt: skip
            self.layers[name] = [points]
            self.layers.setdefault("view directions", []).append(directions)
        lines = row_lines(path)
        if len(lines):
            handle = self._scene.add_line_segments(
                "/part/rows", lines, _bytes(palette.ROW_POINT), thickness=0.003
            )
            self.layers["rows"] = [handle]

    def _add_stations(self) -> None:
        subject = self._data.subject
        if subject.station_plan is None:
            return
        length, width, height = subject.cell.base_size_m
        handles = []
        for number, station in enumerate(subject.station_plan.stations):
            pose = station.T_map_base_link
            node = f"/stations/{station.id}"
            frame = self._scene.add_frame(
                node, wxyz=np.roll(quaternion(pose), 1), position=pose[:3, 3],
                axes_length=0.4, axes_radius=0.01,
            )  # fmt: skip
            self._scene.add_box(
                f"{node}/base", color=_bytes(palette.series(number)),
                dimensions=(length, width, height), position=(0.0, 0.0, 0.5 * height), opacity=0.6,
            )  # fmt: skip
            arm = subject.cell.T_base_link_arm_base
            self._scene.add_frame(
                f"{node}/arm", wxyz=np.roll(quaternion(arm), 1), position=arm[:3, 3],
                axes_length=0.2, axes_radius=0.008,
            )  # fmt: skip
            self._scene.add_label(
                f"{node}/label", f"station {station.id}", position=(0.0, 0.0, height + 0.1)
            )
            handles.append(frame)
        self.layers["stations"] = handles

    def _add_tracker(self) -> None:
        if self._data.subject.station_plan is None:
            return
        tracker, field = add_tracker(self._scene, self._data.subject)
        self.layers["tracker"], self.layers["tracker's range and cone"] = tracker, field

    def _add_colour_switch(self) -> None:
        names = tuple(self.surfaces)
        switch = self._gui.add_dropdown("Part coloured by", names, initial_value=names[0])
        self.switch: Any = switch
        legend = self._gui.add_html(_legend(self._data.colourings[names[0]]))
        if self._data.is_thinned:
            self._gui.add_markdown(
                f"_{len(self._data.display.mesh.faces)} of "
                f"{len(self._data.subject.mesh.faces)} triangles shown_"
            )

        @switch.on_update
        def _(_: Any) -> None:
            for name, handles in self.surfaces.items():
                _show(handles, name == switch.value and surface.value)
            legend.content = _legend(self._data.colourings[switch.value])

        surface = self._gui.add_checkbox("part", True)

        @surface.on_update
        def _(_: Any) -> None:
            _show(self.surfaces[switch.value], surface.value)

    def _add_checkbox(self, name: str, handles: Sequence[Any]) -> None:
        box = self._gui.add_checkbox(name, bool(handles[0].visible))
        self.checkboxes[name] = box

        @box.on_update
        def _(_: Any) -> None:
            _show(handles, box.value)

    def _add_point_slider(self) -> None:
        subject = self._data.subject
        path, scanner = subject.path, subject.scanner
        if path is None or scanner is None or not len(path):
            return
        field = field_mesh(scanner)
        frame = self._scene.add_frame(
            "/part/scanner", axes_length=0.1, axes_radius=0.004, origin_radius=0.012
        )
        self._scene.add_mesh_simple(
            "/part/scanner/field", field.vertices, field.faces, color=_bytes(palette.FIELD),
            opacity=0.35, side="double", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        self.layers["field of view"] = [frame]
        slider = self._gui.add_slider("Scan path point", 0, max(1, len(path) - 1), 1, 0)
        self.slider = slider
        told = self._gui.add_markdown("")

        def place() -> None:
            point = min(int(slider.value), len(path) - 1)
            pose = scanner_pose(path, point)
            frame.position, frame.wxyz = pose[:3, 3], np.roll(quaternion(pose), 1)
            told.content = point_sentence(subject, point)

        slider.on_update(lambda _: place())
        place()
        self._add_arm()

    def _add_arm(self) -> None:
        """The arm stands where the point is scanned; the second slider takes it elsewhere."""
        subject = self._data.subject
        if subject.station_plan is None or not subject.station_plan.stations:
            return
        owner, points = subject.station_of_points(), self.slider
        arm = self.arm = ArmView(self._scene, subject)
        self.layers["arm"] = [arm.base]
        self.layers["line of sight"] = [arm.sight]
        last = len(subject.station_plan.stations) - 1
        stations = self._gui.add_slider("Arm at station", 0, max(1, last), 1, 0)
        self.station_slider = stations
        told = self._gui.add_markdown("")

        field = self.layers["field of view"][0]
        self.clock, ways = add_motion(self._scene, self._gui, subject, arm, field, told)
        self.layers |= ways

        def place() -> None:
            number, point = min(int(stations.value), last), min(int(points.value), len(owner) - 1)
            if self.clock is not None:
                self.clock.stop()
                self.clock.choose(number)
            shown = arm.place(number, point)
            told.content = shown.told[0].upper() + shown.told[1:]

        def follow() -> None:
            station = int(owner[min(int(points.value), len(owner) - 1)])
            if station >= 0 and station != int(stations.value):
                stations.value = station  # places the arm
            else:
                place()

        stations.on_update(lambda _: place())
        points.on_update(lambda _: follow())
        follow()


def _show(handles: Sequence[Any], shown: bool) -> None:
    for handle in handles:
        handle.visible = shown


def _node(name: str) -> str:
    return name.replace(" ", "_")


def _bytes(colour: palette.Colour) -> tuple[int, int, int]:
    red, green, blue = (round(255 * channel) for channel in colour)
    return red, green, blue


def _legend(pieces: Sequence[Piece]) -> str:
    rows = "".join(
        f'<div><span style="display:inline-block;width:1em;height:1em;margin-right:.5em;'
        f'vertical-align:-.1em;background:rgb{_bytes(piece.colour)}"></span>'
        f"{escape(piece.name)}</div>"
        for piece in pieces
    )
    return f'<div style="margin:0 1em;max-height:12em;overflow:auto;font-size:.85em">{rows}</div>'
