from benchmarks.soak import frames


def test_frames_are_counted_as_a_training_logs_them(smoke_run):
    assert frames(smoke_run) > 0
    assert frames(smoke_run / "elsewhere") == 0
