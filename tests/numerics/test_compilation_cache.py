"""The folder of compiled programs has a name on every system (`tests/cli` tests what it holds)."""

from softras2d.numerics import compilation_cache


def test_a_processor_of_which_nothing_is_known_has_a_folder(monkeypatch, tmp_path):
    empty = tmp_path / "cpuinfo"
    for file in (empty, tmp_path / "missing"):
        empty.write_text("")
        monkeypatch.setattr(compilation_cache, "_CPU_INFO", file)
        assert compilation_cache.cache_folder().name
