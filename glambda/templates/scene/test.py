import glambda
from {{ name }} import {{ target }}


def test_it_comes_to_rest():
    run = glambda.simulate({{ target }}())
    assert "rest" in set(run.events["kind"])
