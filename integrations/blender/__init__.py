# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's panel for `retarget`: choose who moves and who shall move, press one button.

The program runs as a child process and gets GLB files; nothing of it is loaded into Blender.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import bpy

from . import transfer


class RetargetPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="Program", description="The retarget program; looked for on the PATH if empty", subtype="FILE_PATH"
    )

    def draw(self, context):
        self.layout.prop(self, "command")


def _is_armature(_, each: bpy.types.Object) -> bool:
    return each.type == "ARMATURE"


def _can_move(_, each: bpy.types.Object) -> bool:
    return each.type == "ARMATURE" or transfer.is_bare(each)


class RetargetSettings(bpy.types.PropertyGroup):
    source: bpy.props.PointerProperty(
        name="Motion of", description="The armature whose action is taken", type=bpy.types.Object, poll=_is_armature
    )
    file: bpy.props.StringProperty(
        name="or file", description="A motion file: BVH, FBX, GLB or glTF, in place of an armature", subtype="FILE_PATH"
    )
    target: bpy.props.PointerProperty(
        name="Onto", description="The armature that shall move, with its meshes; or a bare mesh, which gets one",
        type=bpy.types.Object, poll=_can_move,
    )
    in_place: bpy.props.BoolProperty(name="In place", description="Drop the horizontal path")
    foot_lock: bpy.props.BoolProperty(name="Foot lock", description="Hold what rests on the ground", default=True)


class RETARGET_OT_run(bpy.types.Operator):
    bl_idname = "retarget.run"
    bl_label = "Retarget"
    bl_description = "Put the motion on the character: a new action on its own armature, or on one that it gets"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        settings = context.scene.retarget
        return context.mode == "OBJECT" and settings.target is not None and bool(settings.source or settings.file)

    def execute(self, context):
        """Without a window (scripts, background): wait for the result."""
        try:
            self._start(context)
            self._child.wait()
            return self._finish(context)
        except ValueError as error:
            return self._fail(error)

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        try:
            self._start(context)
        except ValueError as error:
            return self._fail(error)
        self._timer = context.window_manager.event_timer_add(0.1, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("Retargeting; Esc stops it")
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self._child.kill()
            self._child.wait()
            self._leave(context)
            self._folder.cleanup()
            return {"CANCELLED"}
        if event.type != "TIMER" or self._child.poll() is None:
            return {"PASS_THROUGH"}
        self._leave(context)
        try:
            return self._finish(context)
        except ValueError as error:
            return self._fail(error)

    def _start(self, context) -> None:
        """Write what the program reads and start it. Raises `ValueError`."""
        settings = context.scene.retarget
        preferences = context.preferences.addons[__package__].preferences if __package__ in context.preferences.addons else None
        command = transfer.program(preferences.command if preferences else "")
        self._folder = tempfile.TemporaryDirectory(prefix="retarget-")
        folder = Path(self._folder.name)
        self._target, self._result = settings.target, folder / "result.glb"
        self._bare = transfer.is_bare(settings.target)
        (transfer.export_mesh if self._bare else transfer.export_target)(settings.target, folder / "target.glb")
        if settings.file:
            source = Path(bpy.path.abspath(settings.file))
            if source.suffix.lower() not in transfer.MOTION_FILES or not source.is_file():
                raise ValueError(f"{source} is no motion file ({', '.join(sorted(transfer.MOTION_FILES))})")
            self._name = source.stem
        else:
            if settings.source == settings.target:
                raise ValueError("the motion is the character's own already")
            source = folder / "source.glb"
            self._name = transfer.export_source(settings.source, source)
        fps = context.scene.render.fps / context.scene.render.fps_base
        options = ["--fps", f"{fps:g}", *(["--in-place"] if settings.in_place else [])]
        options += [] if settings.foot_lock else ["--no-foot-lock"]
        self._log = open(folder / "log.txt", "w+", encoding="utf-8", errors="replace")
        self._child = subprocess.Popen(
            [command, "run", str(source), str(folder / "target.glb"), "-o", str(self._result), *options],
            stdin=subprocess.DEVNULL, stdout=self._log, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def _finish(self, context):
        """Take the result, or say what the program said. Raises `ValueError`."""
        self._log.seek(0)
        said = [line.strip() for line in self._log if line.strip()]
        self._log.close()
        try:
            if self._child.returncode != 0 or not self._result.exists():
                raise ValueError(said[-1] if said else f"retarget ended with {self._child.returncode}")
            take = transfer.bring_character if self._bare else transfer.bring_back
            action = take(self._result, self._target, f"{self._name} retargeted")
        finally:
            self._folder.cleanup()
        context.scene.frame_end = max(context.scene.frame_end, round(action.frame_range[1]))
        self.report({"INFO"}, said[-1] if said else f"{action.name} on {self._target.name}")
        return {"FINISHED"}

    def _leave(self, context) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def _fail(self, error: ValueError):
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}


class RETARGET_PT_panel(bpy.types.Panel):
    bl_label = "Retarget"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Retarget"

    def draw(self, context):
        settings = context.scene.retarget
        self.layout.use_property_split = True
        for name in ("source", "file", "target", "in_place", "foot_lock"):
            self.layout.prop(settings, name)
        self.layout.operator(RETARGET_OT_run.bl_idname)


CLASSES = (RetargetPreferences, RetargetSettings, RETARGET_OT_run, RETARGET_PT_panel)


def register() -> None:
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.retarget = bpy.props.PointerProperty(type=RetargetSettings)


def unregister() -> None:
    del bpy.types.Scene.retarget
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
