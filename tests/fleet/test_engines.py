"""On real engines, with queries that are started again, the result is that of one process."""

import os
import pickle
import subprocess
import sys
import time

import numpy as np
import pytest
from support import of_matrices

from robust_filterpy import ARX, RobustKalmanFilter
from robust_filterpy.fleet import FilterModel, TrackerModel, filter_table, step

pd = pytest.importorskip("pandas")
pytestmark = pytest.mark.engines


def model():
    kf = of_matrices(RobustKalmanFilter, [[1.0, 0.1], [0.0, 1.0]], [[1.0, 0.0]], 0.01)
    return FilterModel(kf, measurements=["z"], time="t", dt=1.0)


def samples(keys, steps, seed=0):
    """Samples of many devices, in no order at all, some missing, one device with a duplicate."""
    rng = np.random.default_rng(seed)
    device, t = np.divmod(np.arange(keys * steps), steps)
    z = rng.normal(size=keys * steps) * np.where(rng.random(keys * steps) < 0.1, 20.0, 1.0)
    table = pd.DataFrame({"device": device, "t": t.astype(float), "z": z})
    table = table[(rng.random(len(table)) > 0.02) | (table["t"] == 0.0)]
    table = pd.concat([table, table[table["device"] == 3][:1]])
    return table.sample(frac=1.0, random_state=seed).reset_index(drop=True)


def assert_same(found, table, described=None):
    """Hold a result together with that of one process, in whatever order it came, to the last bit."""
    expected = filter_table(model() if described is None else described, table, sort=True)
    found, expected = (one.sort_values(["device", "t"], ignore_index=True) for one in (found, expected))
    pd.testing.assert_frame_equal(found[expected.columns.tolist()], expected, check_exact=True, check_dtype=False)
    assert expected["error"].notna().sum() == 1


# Dask


@pytest.fixture(scope="module")
def dask_frame():
    dd = pytest.importorskip("dask.dataframe")
    return lambda table, parts: dd.from_pandas(table, npartitions=parts)


def test_on_dask_the_result_is_that_of_one_process(dask_frame):
    from robust_filterpy.fleet.dask import filter_frame

    table = samples(200, 12)
    assert_same(filter_frame(dask_frame(table, 5), model()).compute(scheduler="synchronous"), table)
    whole = table[table["device"] != 3].sort_values(["device", "t"], ignore_index=True)
    already = filter_frame(dask_frame(whole, 1), model(), partitioned=True).compute(scheduler="synchronous")
    pd.testing.assert_frame_equal(already, filter_table(model(), whole))
    with pytest.raises(ValueError, match="time: expected"):
        filter_frame(dask_frame(table, 5), FilterModel(model().template(), measurements=["z"]))


# Spark


@pytest.fixture(scope="module")
def spark():
    sql = pytest.importorskip("pyspark.sql")
    try:
        subprocess.run(["java", "-version"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no Java")
    builder = sql.SparkSession.builder.master("local[2]").config("spark.ui.enabled", "false")
    os.environ["PYSPARK_PYTHON"] = sys.executable
    settings = {
        "spark.sql.shuffle.partitions": "2", "spark.driver.bindAddress": "127.0.0.1", "spark.driver.host": "127.0.0.1",
        "spark.driver.memory": "4g", "spark.driver.maxResultSize": "2g",
        "spark.sql.execution.arrow.pyspark.enabled": "true",
    }  # fmt: skip
    for name, value in settings.items():
        builder = builder.config(name, value)
    session = builder.getOrCreate()
    session.sparkContext.setLogLevel("ERROR")
    yield session
    session.stop()


@pytest.mark.slow
def test_on_spark_the_result_is_that_of_one_process(spark):
    from robust_filterpy.fleet.spark import filter_frame

    table = samples(200, 12)
    assert_same(filter_frame(spark.createDataFrame(table), model(), groups=5).toPandas(), table)


def run_query(spark, described, folder, schema, **options):
    """Run a streaming query over the files that are there, from its checkpoint."""
    from robust_filterpy.fleet.spark import step_stream

    stream = spark.readStream.schema(schema).option("maxFilesPerTrigger", 1).parquet(str(folder / "in"))
    query = (
        step_stream(stream, described, **options)
        .writeStream.format("parquet")
        .option("path", str(folder / "out"))
        .option("checkpointLocation", str(folder / "checkpoint"))
        .outputMode("append")
        # A query that forgets never says that there is no more to do.
        .trigger(**({"once": True} if options else {"availableNow": True}))
        .start()
    )
    query.awaitTermination(300)


def arrives(folder, number, part):
    """Put a file there; the stream takes files by their age, and these may be of the same millisecond."""
    file = folder / "in" / f"{number}.parquet"
    file.parent.mkdir(exist_ok=True)
    part.to_parquet(file, index=False)
    os.utime(file, (time.time() - 60.0 + number,) * 2)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"forget_after": 3600.0}])
def test_a_streaming_query_goes_on_from_its_checkpoint(spark, tmp_path, options):
    table = samples(60, 12).sort_values("t", kind="stable")
    described = model()
    object.__setattr__(described, "late", "drop")
    for k in range(4):
        arrives(tmp_path, k, table[(table["t"] >= 3 * k) & (table["t"] < 3 * k + 3)])
        if k in (1, 3):
            # It ends, and is started again from its checkpoint.
            run_query(spark, described, tmp_path, "device long, t double, z double", **options)
    found = spark.read.parquet(str(tmp_path / "out")).toPandas()
    expected = filter_table(described, table, sort=True).sort_values(["device", "t"], ignore_index=True)
    found = found.sort_values(["device", "t"], ignore_index=True)
    pd.testing.assert_frame_equal(found[list(expected)], expected, check_exact=True, check_dtype=False)
    assert len(found) == len(expected) >= len(table) - 1


@pytest.mark.slow
def test_a_key_without_samples_is_forgotten_and_begins_anew(spark, tmp_path):
    from robust_filterpy.fleet.spark import step_stream

    table = samples(3, 9).sort_values("t", kind="stable")
    first = table["device"].iloc[0]
    mine, described = table["device"] == first, model()
    object.__setattr__(described, "late", "drop")
    for k in range(3):
        part = table[(table["t"] >= 3 * k) & (table["t"] < 3 * k + 3)]
        # In between one device speaks, and the others are forgotten.
        arrives(tmp_path, k, part[part["device"] == first] if k == 1 else part)
        run_query(spark, described, tmp_path, "device long, t double, z double", forget_after=1e-3)
    found = spark.read.parquet(str(tmp_path / "out")).toPandas().sort_values(["device", "t"], ignore_index=True)
    parts = [table[mine], table[~mine & (table["t"] < 3)], table[~mine & (table["t"] >= 6)]]
    expected = pd.concat([filter_table(described, part, sort=True) for part in parts])
    expected = expected.sort_values(["device", "t"], ignore_index=True)
    pd.testing.assert_frame_equal(found[list(expected)], expected, check_exact=True, check_dtype=False)
    with pytest.raises(ValueError, match="forget_after: expected"):
        step_stream(spark.createDataFrame(table), model(), forget_after=0.0)


# A stream of messages


@pytest.mark.parametrize(
    "described",
    [model(), TrackerModel(ARX(1, 1), {"start": 0}, time="t", measurements=["y"], inputs=["u"])],
    ids=["filter", "tracker"],
)
def test_a_stream_goes_on_from_its_store(described, tmp_path):
    stores = pytest.importorskip("quixstreams.state.rocksdb")
    from robust_filterpy.fleet.stream import StreamStep

    rng = np.random.default_rng(4)
    names = [*described.measurements, *(described.inputs or ())]
    messages = [
        (f"d{i}", {"t": float(k), **{name: rng.normal() for name in names}}) for k in range(12) for i in range(4)
    ]
    messages[9][1][names[0]] = None
    found = {}
    for start, stop in ((0, 17), (17, 48)):
        # The process ends in between: what goes on is what is on the disk, and a pickled step.
        taken = pickle.loads(pickle.dumps(StreamStep(described)))
        store = stores.RocksDBStore("default", "samples", str(tmp_path))
        store.assign_partition(0)
        with store.start_partition_transaction(0) as transaction:
            for key, message in messages[start:stop]:
                found.setdefault(key, []).append(taken(message, transaction.as_state(prefix=key)))
            late = taken({**messages[start][1], "t": -1.0}, transaction.as_state(prefix=messages[start][0]))
            assert late is None
        store.close()
    for key, rows in found.items():
        table = pd.DataFrame([message for name, message in messages if name == key]).astype(float)
        expected = step(described, None, table)[1]
        actual = pd.DataFrame(rows).drop(columns=["error", "dropped"]).astype(float)
        names = [name for name in expected if name != "error"]
        pd.testing.assert_frame_equal(actual[names], expected[names], check_exact=True)


class Store(dict):
    """Where a stream keeps the states of one key."""

    get_bytes = dict.get
    set_bytes = dict.__setitem__


def test_a_message_that_is_refused_is_named_and_a_late_one_dropped_and_counted():
    from robust_filterpy.fleet.stream import StreamStep

    store, taken = Store(), StreamStep(model())
    assert taken({"t": 0.0, "z": 1.0}, store)["error"] is None
    for message, reason in (
        ({"z": 1.0}, "expected a time, got"),
        ("text", "expected a mapping"),
        ({"t": 10**400, "z": 1.0}, "expected a time, got"),
        ({"t": "2026-01-01", "z": 1.0}, "no time zone"),
    ):
        answer = taken(message, store)
        assert reason in answer["error"] and answer["x0"] is None
    for t in (0.0, 0.3, -1.0):
        assert taken({"t": t, "z": 1.0}, store) is None
    answer = taken({"t": 1.0, "z": "a"}, store)
    assert "got 'a'" in answer["error"] and answer["dropped"] == 3
    assert answer["x0"] is not None and answer["weight0"] is None
    answer = taken({"t": 2.0, "z": 1.0}, store)
    assert answer["error"] is None and answer["dropped"] == 3
    refusing = StreamStep(FilterModel(model().template(), measurements=["z"], time="t", late="refuse", dt=1.0))
    assert "duplicate" in refusing({"t": 2.0, "z": 1.0}, store)["error"]
    store["robust_filterpy"] = store["robust_filterpy"][:-9]
    assert "damaged" in taken({"t": 3.0, "z": 1.0}, store)["error"]
    with pytest.raises(ValueError, match="measurements"):
        StreamStep(FilterModel(model().template()))
    with pytest.raises(TypeError, match="model"):
        StreamStep(None)
