"""The article's refinements of clusters: rows of people cut, boxes inside boxes joined, feet trimmed."""

from benchmarks.article.second_look import Refinements, refine_clusters
from services.infra_lidar.config import ClusteringConfig
from tests.infra_lidar.made_clusters import clusters_of_parts, solid

PLAIN = ClusteringConfig(merge="off", split="off")


def test_people_in_a_row_are_cut_at_the_gap_as_in_the_article():
    config = ClusteringConfig(split="off", merge="off", body_height_m=0.0, cell_m=0.5, cell_growth_m=0.0)
    people = solid((8, 0), (0.5, 0.5), (0.2, 1.7), n=300), solid((8, 1.4), (0.5, 0.5), (0.2, 1.7), n=300, seed=1)
    bridge = solid((8, 0.7), (0.1, 1.2), (0.9, 1.0), n=12)
    joined, owner = clusters_of_parts(*people, bridge, config=config)
    assert len(joined.box) == 1
    found = refine_clusters(joined, Refinements(trim=False, join=False))
    assert len(found.box) == 2
    of_point = found.cluster_id(len(owner))
    assert all(len(set(of_point[owner == k].tolist()) - {-1}) == 1 for k in range(2))


def test_a_box_inside_another_joins_it_as_in_the_article():
    frame = (
        solid((10, 0), (4.0, 0.1), (0.2, 1.5)),
        solid((10, 2.0), (4.0, 0.1), (0.2, 1.5)),
        solid((8.05, 1.0), (0.1, 2.0), (0.2, 1.5)),
    )
    inner = solid((10, 1.0), (0.4, 0.4), (0.4, 1.2), n=60)
    apart, _ = clusters_of_parts(*frame, inner, config=PLAIN)
    assert len(apart.box) == 2
    assert len(refine_clusters(apart, Refinements(trim=False, split=False)).box) == 1


def test_feet_are_trimmed_as_in_the_article():
    person = solid((8, 0), (0.5, 0.5), (0.16, 1.7), n=200)
    found = refine_clusters(clusters_of_parts(person, config=PLAIN)[0], Refinements(split=False, join=False))
    assert found.counts.tolist() == [200 - int(0.05 * 200) - 1]
