"""URDF texts as manufacturers write them, and a reader of URDF that shares nothing with hilcell's.

`reached_mm` follows the standard with ElementTree and scipy: it judges what hilcell reads and
writes.
"""

from collections.abc import Mapping
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from hilcell.geometry.kinematics import Array

IRB120 = """<?xml version="1.0" encoding="UTF-8"?>
<!-- nominal, from the data sheet -->
<robot name="IRB 120" xmlns:xacro="http://wiki.ros.org/xacro">
  <material name="orange"><color rgba="1 0.4 0 1"/></material>
  <link name="base_link">
    <visual><origin xyz="9 9 9"/><geometry><mesh filename="package://base.stl"/></geometry></visual>
  </link>
  <link name="link_1"/> <link name="link_2"/> <link name="link_3"/>
  <link name="link_4"/> <link name="link_5"/> <link name="link_6"/> <link name="tool0"/>
  <joint type="revolute" name="joint_1">
    <origin xyz="0 0 0" rpy="0 0 0"/>
    <parent link="base_link"/> <child link="link_1"/>
    <limit effort="0" lower="-2.87979" upper="2.87979" velocity="4.36332"/>
    <axis xyz="0 0 1"/>
  </joint>
  <joint name="joint_2" type="revolute">
    <origin rpy='0 0 0' xyz='0 0 0.29'></origin>
    <parent link="link_1"/> <child link="link_2"/> <axis xyz="0 1 0"/>
    <limit effort="0" lower="-1.91986" upper="1.91986" velocity="4.36332"/>
  </joint>
  <joint name="joint_3" type="revolute">
    <origin xyz="0 0 0.27"/>  <!-- upper arm -->
    <parent link="link_2"/> <child link="link_3"/> <axis xyz="0 2 0"/>
    <limit effort="0" lower="-1.91986" upper="1.22173" velocity="4.36332"/>
  </joint>
  <joint name="joint_4" type="continuous">
    <parent link="link_3"/> <child link="shifted"/>
  </joint>
  <link name="shifted"/>
  <joint name="forearm" type="fixed">
    <origin xyz="0.134 0 0.07" rpy="0.1 0.2 0.3"/> <parent link="shifted"/> <child link="link_4"/>
  </joint>
  <joint name="joint_5" type="revolute">
    <origin xyz="0.168 0 0" rpy="0 0 0"/> <parent link="link_4"/> <child link="link_5"/>
    <axis xyz="0 1 0"/> <limit lower="-2.0944" upper="2.0944"/>
  </joint>
  <joint name="joint_6" type="revolute">
    <origin xyz="0.072 0 0" rpy="0 0 0"/> <parent link="link_5"/> <child link="link_6"/>
    <axis xyz="1 0 0"/> <limit lower="-6.98132" upper="6.98132"/>
  </joint>
  <joint name="flange" type="fixed">
    <origin xyz="0 0 0" rpy="0 1.57079632679 0"/>
    <parent link="link_6"/> <child link="tool0"/>
  </joint>
  <transmission name="t">
    <joint name="joint_1" type="prismatic"><origin xyz="x"/></joint>
  </transmission>
</robot>
"""


RAIL = """<link name="floor"/>
  <joint name="rail" type="prismatic">
    <origin xyz="0.1 0.2 0" rpy="0 0 0.01"/> <parent link="floor"/> <child link="base_link"/>
    <axis xyz="1 0 0"/> <limit effort="0" lower="-2.5" upper="4" velocity="1"/>
  </joint>
"""
ON_RAIL = IRB120.replace('<link name="link_1"/>', RAIL + '<link name="link_1"/>')
PLAIN = (  # as the data sheet has it: the forearm is not turned
    IRB120.replace('xyz="0.134 0 0.07" rpy="0.1 0.2 0.3"', 'xyz="0.134 0 0"').replace(
        '<parent link="link_3"/>', '<parent link="link_3"/><origin xyz="0 0 0.07"/>'
    )
)


def reached_m(text: str | bytes, joints: Mapping[str, float], tip: str = "tool0") -> Array:
    """Return the tip's frame (4, 4) in the root link, in m, of joints by name in rad or m."""
    root = ET.fromstring(text)
    above = {_link(joint, "child"): joint for joint in root.findall("joint")}
    pose = RigidTransform.identity()
    while tip in above:
        joint = above[tip]
        pose = _step(joint, joints.get(joint.attrib["name"], 0.0)) * pose
        tip = _link(joint, "parent")
    return np.asarray(pose.as_matrix())


def _link(joint: ET.Element, part: str) -> str:
    found = joint.find(part)
    assert found is not None
    return found.attrib["link"]


def _step(joint: ET.Element, value: float) -> RigidTransform:
    origin, axis = joint.find("origin"), joint.find("axis")
    xyz = _three(origin, "xyz", "0 0 0")
    turn = Rotation.from_euler("xyz", _three(origin, "rpy", "0 0 0"))  # fixed axes: r, p, y
    direction = _three(axis, "xyz", "1 0 0")
    direction /= np.linalg.norm(direction)
    origin_frame = RigidTransform.from_components(xyz, turn)
    if joint.attrib["type"] == "prismatic":
        return origin_frame * RigidTransform.from_translation(value * direction)
    return origin_frame * RigidTransform.from_rotation(Rotation.from_rotvec(value * direction))


def _three(element: ET.Element | None, name: str, default: str) -> Array:
    text = default if element is None else element.get(name, default)
    return np.array([float(cell) for cell in text.split()])
