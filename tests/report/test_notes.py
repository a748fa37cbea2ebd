"""What is to be known of a recording: each note once, of all cameras that it holds of."""

from jaxpoint.report.notes import merged_notes


def test_what_holds_of_several_cameras_is_one_sentence():
    notes = [
        "Camera 'cam_0' has no frame in 3 of 10 frames.",
        "The clock of camera 'cam_1' drifts by +40 ms over the recording.",
        "The videos have unlike frame rates (25, 30).",
        "Camera 'cam_2' has no frame in 3 of 10 frames.",
        "Camera 'cam_3' has no frame in 4 of 10 frames.",
        "Camera 'Hall A' has no frame in 3 of 10 frames.",
        "The clock of camera 'cam_0' drifts by +40 ms over the recording.",
        "The videos have unlike frame rates (25, 30).",
    ]
    assert merged_notes(notes) == [
        "Each of the cameras 'cam_0', 'cam_2' and 'Hall A' has no frame in 3 of 10 frames.",
        "The clock of each of the cameras 'cam_1' and 'cam_0' drifts by +40 ms over the recording.",
        "The videos have unlike frame rates (25, 30).",
        "Camera 'cam_3' has no frame in 4 of 10 frames.",
    ]
