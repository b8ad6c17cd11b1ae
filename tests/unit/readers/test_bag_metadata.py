"""metadata.yaml of a ROS 2 bag, edited: whatever stands in it, one clear line or the bag read without it."""

import copy

import pytest
import yaml

from bag_maker import make_bag, usual
from gnomon.errors import GnomonError
from gnomon.readers.images.image_recording import open_images


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return make_bag(tmp_path_factory.mktemp("bag"), "ros2", usual())


@pytest.mark.parametrize("value", [True, 3, None, 1.5, [1], {"a": 1}])
@pytest.mark.parametrize("key", ["name", "type", "serialization_format", "offered_qos_profiles"])
def test_names_that_are_none(key, value, bag, tmp_path):
    described = yaml.safe_load((bag / "metadata.yaml").read_text())
    for topic in range(len(described["rosbag2_bagfile_information"]["topics_with_message_count"])):
        edited = copy.deepcopy(described)
        edited["rosbag2_bagfile_information"]["topics_with_message_count"][topic]["topic_metadata"][key] = value
        folder = tmp_path / str(topic)
        folder.mkdir()
        for file in bag.iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        (folder / "metadata.yaml").write_text(yaml.safe_dump(edited))
        try:
            assert open_images(folder, need_imu=False).streams
        except GnomonError as error:
            assert str(error)  # noqa: PT017
