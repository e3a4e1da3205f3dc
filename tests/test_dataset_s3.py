"""Claims about object stores, on an S3 server of this machine: the same files as in a folder, failures in one line."""

from functools import partial

import pytest

from benchmarks import kill_points
from handtrack.errors import InputError
from synth.dataset.engine import Stopped, pooled, run, serial
from synth.dataset.record import DatasetRecord
from synth.dataset.store import digest, names, open_store, put, read, tree_digest

RECORD = DatasetRecord("shards", 1, 30, 10, (), ())
FIXED = [("scene.yaml", b"scene\n")]


@pytest.fixture(scope="module")
def endpoint():
    from moto.server import ThreadedMotoServer

    with pytest.MonkeyPatch.context() as patch:
        for name, value in (
            ("AWS_ACCESS_KEY_ID", "test"),
            ("AWS_SECRET_ACCESS_KEY", "test"),
            ("AWS_DEFAULT_REGION", "us-east-1"),
            ("AWS_EC2_METADATA_DISABLED", "true"),
            ("NO_PROXY", "127.0.0.1"),
        ):
            patch.setenv(name, value)
        server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
        server.start()
        host, port = server.get_host_and_port()
        address = f"http://{host}:{port}"
        patch.setenv("AWS_ENDPOINT_URL", address)
        import boto3

        boto3.client("s3", endpoint_url=address).create_bucket(Bucket="hands")
        yield address
        server.stop()


def _made(store, engine=serial, make=kill_points.make):
    return run(store, RECORD, FIXED, make, kill_points.merge, engine, lambda *_: None)


def test_a_bucket_gets_the_bytes_of_a_folder(endpoint, tmp_path):
    there, here = open_store("s3://hands/one/data"), open_store(str(tmp_path / "data"))
    _made(there, partial(pooled, workers=2))
    _made(here)
    assert names(there) == names(here)
    assert tree_digest(there) == tree_digest(here)
    assert read(there, "shards/00001.txt", 7, 12) == b"00001"


def test_a_run_that_stopped_goes_on_in_a_bucket(endpoint):
    store = open_store("s3://hands/two", [f'client_kwargs={{"endpoint_url": "{endpoint}"}}'])

    def stops(unit):
        if unit.number == 2:
            raise OSError(5, "stopped", "here")
        return kill_points.make(unit)

    with pytest.raises(Stopped, match="here: stopped; what is finished stays"):
        _made(store, make=stops)
    assert "complete.json" not in names(store)
    assert _made(store).made == 10
    assert _made(store).made == 0
    assert tree_digest(store) == tree_digest(open_store("s3://hands/one/data"))


def test_another_dataset_in_a_bucket_is_refused(endpoint):
    store = open_store("s3://hands/three")
    put(store, [("file", b"")])
    with pytest.raises(InputError, match="holds other files"):
        _made(store)


def test_missing_files_and_buckets_are_told(endpoint):
    with pytest.raises(FileNotFoundError, match="nothing"):
        digest(open_store("s3://hands/one"), "nothing")
    with pytest.raises(Stopped, match="s3://no-bucket/a"):
        _made(open_store("s3://no-bucket/a"))


def test_a_server_that_is_not_there_is_told(endpoint):
    options = ['client_kwargs={"endpoint_url": "http://127.0.0.1:9"}', 'config_kwargs={"retries": {"max_attempts": 0}}']
    with pytest.raises(Stopped, match=r"http://127\.0\.0\.1:9"):
        _made(open_store("s3://hands/four", options))
